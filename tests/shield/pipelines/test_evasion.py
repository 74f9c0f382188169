"""Evasion of a violator: the executed evasion clears every other vehicle."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from clause_scenes import CONFIG, DT, after, along, scene_of
from cores import ContinuousCore, ShieldCore

from shield import Tier
from shield.pipelines import frames as of_frames
from shield.pipelines import inputs as of_inputs


def pressed(core, gap):
    """The scene with a vehicle in the ego's buffer from behind and a leader at this gap, and its decision."""
    cars = (-7.05, 0.0, 0.0, 18.0), (gap, 0.0, 0.0, 10.0)
    moved = [(x + v * DT, y, psi, v) for x, y, psi, v in cars]
    now = scene_of((15 * DT, 0, 0, 15), *moved, lanes=1, speed=30.0)
    return now, after(core(), scene_of((0, 0, 0, 15), *cars, lanes=1, speed=30.0), now)


def last_of_them(expected, worst):
    """In the place of `least_bad_evasion`: the last, which accelerates."""
    return len(worst.margin) - 1


@pytest.mark.parametrize("core", [ShieldCore, ContinuousCore])
def test_an_evasion_of_a_violator_clears_all_other_vehicles(core):
    """One behind runs into the buffer; the ego gets away from it, but only as far as its leader leaves the room."""
    tiers = []
    for gap in np.arange(12.0, 50.0, 0.21):
        now, decision = pressed(core, gap)
        tiers.append(decision.tier)
        if decision.tier is Tier.EVADED:
            path = decision.plan if core is ShieldCore else decision.plan[1:]
            assert along(now, path, ignored=np.array([True, False])) >= 0
    assert tiers.count(Tier.EVADED) > 100
    # Braking in the stored lane is one of the evasions: where it clears the others, something does.
    assert Tier.STORED_PLAN not in tiers


@pytest.mark.parametrize(("core", "procedure"), [(ShieldCore, of_frames), (ContinuousCore, of_inputs)])
def test_every_candidate_evasion_clears_all_other_vehicles(core, procedure, monkeypatch):
    """The choice is made among inputs that clear the other vehicles."""
    monkeypatch.setattr(procedure, "least_bad_evasion", last_of_them)
    taken = []
    for gap in np.arange(12.0, 20.0, 0.07):
        now, decision = pressed(core, gap)
        assert decision.tier is Tier.EVADED
        path = decision.plan if core is ShieldCore else decision.plan[1:]
        assert along(now, path, ignored=np.array([True, False])) >= 0
        taken.append(decision.executed.acceleration if core is ShieldCore else decision.executed[0])
    assert len(np.unique(taken)) > 1


def test_no_evasion_of_a_stopping_leader_blocks_the_vehicle_beside():
    """The leader stops more abruptly than permitted; another vehicle beside the ego leaves more room or less."""
    tiers, sides = [], []
    for speed, gap in itertools.product((20.0, 24.0, 28.0), np.arange(8.0, 40.0, 0.2)):
        before = scene_of((0, 0, 0, 33), (44, 0, 0, 14), (gap, 4, 0, speed), lanes=2, speed=35.0)
        moved = (44 + 6 * DT, 0, 0, 6), (gap + speed * DT, 4, 0, speed)
        now = scene_of((33 * DT, 0, 0, 33), *moved, lanes=2, speed=35.0)
        decision = after(ShieldCore(), before, now)
        tiers.append(decision.tier)
        if decision.tier is Tier.EVADED:
            sides.append(round(decision.plan[-1, 1] / 4.0))
            assert along(now, decision.plan, ignored=np.array([True, False])) >= 0
    assert {0, 1} <= set(sides)
    assert Tier.STORED_PLAN not in tiers


@pytest.mark.parametrize("core", [ShieldCore, ContinuousCore])
@pytest.mark.parametrize("gap", [44.0, 44.5])
def test_a_violator_ahead_is_answered_with_the_hardest_braking(core, gap):
    """The leader stops more abruptly than permitted; no input stays clear, and several are clear equally long."""
    shield = core()
    before = scene_of((0, 0, 0, 33), (gap, 0, 0, 14), lanes=1, speed=35.0)
    now = scene_of((33 * DT, 0, 0, 33), (gap + 6 * DT, 0, 0, 6), lanes=1, speed=35.0)
    decision = after(shield, before, now)
    assert decision.tier is Tier.EVADED
    taken = decision.executed.acceleration if core is ShieldCore else decision.executed[0]
    assert taken == pytest.approx(-CONFIG.braking)
