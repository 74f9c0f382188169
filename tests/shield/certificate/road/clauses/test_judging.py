"""Each clause of the certificate where it is the one that binds: `make mutants` switches them off one by one."""

from __future__ import annotations

import itertools
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from clause_scenes import CONFIG, DT, after, along, margin, scene_of
from cores import ContinuousCore, LotCore, MetaCore, ShieldCore

from dynamics.scenes.parking_lot import Lot
from dynamics.scenes.scene import Scene
from dynamics.traffic.rules_of_the_road import Rule
from dynamics.vehicle.rollouts import Rollouts
from shield import Decision, Reason, Tier
from shield.certificate.road.clauses.edge import verdicts
from shield.certificate.road.manoeuvres import brake_candidates
from shield.certificate.road.verify import Surveyor
from shield.pipelines import frames as of_frames
from shield.pipelines import inputs as of_inputs
from shield.pipelines.frames import first_verified


def frame(scene):
    return ShieldCore().supervise(scene)[1]


def action(index):
    return lambda scene: ShieldCore().decide(scene, index)


def held_action(index):
    return lambda scene: MetaCore().decide(scene, index)


def inputs(a, wheel):
    return lambda scene: ContinuousCore(predictive=False).filter(scene, np.array([a, wheel]))[1]


def masked(scene):
    core = ShieldCore()
    mask = core.mask(scene)
    margins = core.meta._verify(core.look(scene), range(5), [scene.target_of(a) for a in range(5)])
    worst = min((v.margin for v, m in zip(margins, mask, strict=True) if m), default=-np.inf)
    return Decision(0, 0, Reason.NONE, Tier.PASSED if mask.any() else Tier.EMERGENCY, worst, 0.0)


DOORS = {
    "frame": frame,
    "lane change": action(2),
    "faster": action(3),
    "slower": action(4),
    "held lane change": held_action(2),
    "held faster": held_action(3),
    "throttle": inputs(5.0, 0.0),
    "throttle and wheel": inputs(1.0, 0.01),
    "mask": masked,
}


@pytest.mark.parametrize("door", DOORS)
def test_nothing_verified_has_a_negative_margin(door):
    found, far = [], 150.0 if door.startswith("held") else 60.0
    for gap in np.arange(9.0, far, 0.21):
        cars = (gap, 0.0, 0.0, 14.0), (gap + 4.0, 4.0, 0.0, 14.0), (gap - 60.0, 4.0, 0.0, 26.0)
        found.append(DOORS[door](scene_of((0.0, 0.0, 0.0, 20.0), *cars, speed=25.0, lanes=2)))
    verified = [d for d in found if d.tier.verified]
    assert verified
    assert len(verified) < len(found)
    assert min(d.margin for d in verified) >= 0


def braked(scene):
    """The path of braking in lane 0 from now on, (K, 4)."""
    return brake_candidates(scene, [0], [0.0], [0], 0, CONFIG.braking).paths(Rollouts(DT), scene.ego_road)[0]


@pytest.mark.parametrize("door", ["frame", "throttle"])
def test_what_nearly_verifies_does_not_stand_in_the_way_of_what_does(door):
    """Where braking verifies, something that verifies is executed."""
    found = []
    for gap in np.arange(9.0, 30.0, 0.1):
        scene = scene_of((0.0, 0.0, 0.0, 20.0), (gap, 0.0, 0.0, 14.0), speed=25.0, lanes=1)
        if along(scene, braked(scene)) >= 1e-6:
            found.append(DOORS[door](scene).tier)
    assert all(tier.verified for tier in found)
    assert Tier.GOVERNED in found


def test_the_first_that_verifies_is_taken_and_else_the_best():
    assert first_verified(np.array([-0.1, 0.2, 0.3])) == 1
    assert first_verified(np.array([-0.2, -0.1])) == 1


def test_an_input_passes_in_whichever_lane_its_fail_safe_stops():
    """Astride of a marking, behind one in the lane that comes first."""
    passed = []
    for gap in np.arange(9.0, 40.0, 0.1):
        core, scene = ContinuousCore(predictive=False), scene_of((0, 1.9, 0.05, 20), (gap, 0, 0, 0), lanes=2)
        proposal = np.zeros(2)
        verifies = [core.judge(scene, proposal[None], [lane]).margin[0] >= 0 for lane in (0, 1)]
        passed.append((any(verifies), verifies[0]))
        assert (core.filter(scene, proposal)[1].tier is Tier.PASSED) == any(verifies)
    assert (True, False) in passed


def pressed(core, gap):
    """The scene with one behind the ego in its buffer, and a leader so far ahead; and what is decided in it."""
    cars = (-7.05, 0.0, 0.0, 18.0), (gap, 0.0, 0.0, 10.0)
    moved = [(x + v * DT, y, psi, v) for x, y, psi, v in cars]
    now = scene_of((15 * DT, 0, 0, 15), *moved, lanes=1, speed=30.0)
    return now, after(core(), scene_of((0, 0, 0, 15), *cars, lanes=1, speed=30.0), now)


@pytest.mark.parametrize("core", [ShieldCore, ContinuousCore])
def test_what_evades_an_offender_clears_everybody_else(core):
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


def last_of_them(expected, worst):
    """In the place of `least_bad_evasion`: the last, which accelerates."""
    return len(worst.margin) - 1


@pytest.mark.parametrize(("core", "procedure"), [(ShieldCore, of_frames), (ContinuousCore, of_inputs)])
def test_whatever_evades_an_offender_clears_everybody_else(core, procedure, monkeypatch):
    """It is among what clears the others that the choice is made, however that is done."""
    monkeypatch.setattr(procedure, "least_bad_evasion", last_of_them)
    taken = []
    for gap in np.arange(12.0, 20.0, 0.07):
        now, decision = pressed(core, gap)
        assert decision.tier is Tier.EVADED
        path = decision.plan if core is ShieldCore else decision.plan[1:]
        assert along(now, path, ignored=np.array([True, False])) >= 0
        taken.append(decision.executed.acceleration if core is ShieldCore else decision.executed[0])
    assert len(np.unique(taken)) > 1


def test_nobody_evades_one_who_stops_into_the_way_of_another():
    """The leader stops more abruptly than anybody may, and beside the ego another leaves more room or less."""
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
def test_an_offender_is_braked_for_as_hard_as_can_be(core, gap):
    """Its leader stops more abruptly than anybody may; nothing is clear for good any more, and some inputs are for as
    long as others."""
    shield = core()
    before = scene_of((0, 0, 0, 33), (gap, 0, 0, 14), lanes=1, speed=35.0)
    now = scene_of((33 * DT, 0, 0, 33), (gap + 6 * DT, 0, 0, 6), lanes=1, speed=35.0)
    decision = after(shield, before, now)
    assert decision.tier is Tier.EVADED
    taken = decision.executed.acceleration if core is ShieldCore else decision.executed[0]
    assert taken == pytest.approx(-CONFIG.braking)


# -- where the ego may be --------------------------------------------------------------------------------------------


def test_a_plan_ends_inside_its_lane():
    assert margin(scene_of((0, 0.6, 0, 0)), 0) >= 0
    assert margin(scene_of((0, 0.8, 0, 0)), 0) < 0


def test_nothing_leads_off_the_road_or_backwards():
    for wheel in np.linspace(-0.1, 0.1, 9):
        scene = scene_of((0, 0, 0, 25), lanes=1)
        plan = ContinuousCore(predictive=False).filter(scene, np.array([0.0, wheel]))[1].plan
        half = 2.5 * np.abs(np.sin(plan[:, 2])) + np.cos(plan[:, 2])
        assert (np.abs(plan[:, 1]) + half <= 2 + 1e-9).all()
    answer, _ = ContinuousCore(predictive=False).filter(scene_of((0, 0, 0, 0.1)), np.array([-5.0, 0.0]))
    assert 0.1 + answer[0] * DT >= -1e-9


@pytest.mark.parametrize(("allowed", "edge", "v"), [(False, 1.0, 1.0), (True, -0.1, 1.0), (True, 1.0, -0.1)])
def test_the_verdict_of_inputs(allowed, edge, v):
    path = np.full((1, 2, 4), v)
    assert verdicts(np.ones(1), np.array([[1.0, edge]]), np.array([allowed]), path, 1)[0] < 0
    assert verdicts(np.ones(1), np.ones((1, 2)), np.ones(1, bool), np.ones((1, 2, 4)), 1)[0] == 1


def test_nothing_leads_through_a_gap_of_the_map():
    env = gym.make("racetrack-v0")
    env.reset(seed=0)
    scene = Scene.from_env(env, curved=True)
    env.close()
    road = scene.road
    place = np.argwhere(np.isfinite(road.gaps.low))[0]
    r = 0.5 * (road.gaps.low[tuple(place)] + road.gaps.high[tuple(place)])
    ego = scene.ego.copy()
    ego[:4] = road.to_world(np.array([(place[0] + 0.5) * 0.1, r, 0.0, 5.0]))
    scene = replace(scene, ego=ego, others=scene.others[:0])
    assert along_gap(scene) == -np.inf
    assert along_gap(replace(scene, road=replace(road, gaps=None))) > -np.inf


def along_gap(scene) -> float:
    path = np.repeat(scene.ego_road[None], 2, axis=0)
    lanes = np.zeros(1, dtype=int)
    return float(Surveyor(scene, CONFIG).clearance(path[None], lanes, lanes).margin[0])


def test_nothing_is_verified_in_a_parking_lot_without_the_clearance():
    """At rest, 3 cm nearer to a wall ahead and to one behind than it should be."""
    walls = np.array([[4.07 * i, 0.0, np.pi / 2, 0.0, 40.0, 3.0] for i in (-1, 1)])
    lot = Lot(np.array([0.0, 0, 0, 0, 5, 2]), walls, DT)
    assert not LotCore().filter(lot, np.array([1.0, 0.0]))[1].tier.verified


# -- the monitor, and the stored plan --------------------------------------------------------------------------------


@pytest.mark.parametrize("core", [ShieldCore, ContinuousCore])
def test_a_violation_is_counted_and_the_stored_plan_outlives_it(core):
    """Somebody jumps in before the ego; the plan for the leader still holds, and is not given up."""
    shield = core()
    start = scene_of((0, 0, 0, 20), (30, 4, 0, 20), (90, 0, 0, 20), lanes=1 + 1)
    assert after(shield, start).tier.verified
    decision = after(shield, scene_of((20 * DT, 0, 0, 20), (10, 1.0, 0, 5), (90 + 20 * DT, 0, 0, 20), lanes=2))
    assert shield.violations == 1
    assert shield.watch.violated
    assert decision.tier in (Tier.EVADED, Tier.STORED_PLAN)


@pytest.mark.parametrize("core", [ShieldCore, ContinuousCore])
def test_who_has_broken_a_rule_is_forgiven_once_a_plan_clears_everybody_again(core):
    """One far ahead stops at once: there is room for that."""
    shield = core()
    before, now = scene_of((0, 0, 0, 10), (60, 0, 0, 20)), scene_of((10 * DT, 0, 0, 10), (60 + 20 * DT, 0, 0, 0))
    after(shield, before)
    assert shield.look(now).memory.watch.violated
    shield.reset()
    assert after(shield, before, now).tier.verified
    assert shield.violations == 1
    assert not shield.watch.violated


@pytest.mark.parametrize("core", [ShieldCore, ContinuousCore])
def test_one_instant_seen_twice_is_one(core):
    """Neither the visibility clock nor the count goes on: who has not moved meanwhile has not stood still."""
    shield = core()
    for k in range(3):
        scene = scene_of((20 * DT * k, 0, 0, 20), (60 + 20 * DT * k, 0, 0, 20))
        first, again = (shield.look(replace(scene, frame=k)) for _ in range(2))
        np.testing.assert_array_equal(first.survey.visible, again.survey.visible)
    assert shield.violations == 0


@pytest.mark.parametrize("core", [ShieldCore, ContinuousCore])
def test_a_stored_plan_is_recorded_with_its_own_margin(core):
    """Somebody is observed all at once, of whom no rule is known to be broken, and leaves no plan; what is least bad is
    another input."""
    shield = core()
    assert after(shield, scene_of((0, 0, 0, 10), lanes=3)).tier.verified
    scene = scene_of((10 * DT, 0, 0, 10), (10.4, 0, 0, 0), (19.5, 0, 0, 19), lanes=3)
    scene = replace(scene, observed=True)
    decision = after(shield, scene)
    assert decision.tier is Tier.STORED_PLAN
    assert decision.margin == pytest.approx(along(scene, braked(scene)))


@pytest.mark.parametrize(("x", "count"), [(12.0, 1), (90.0, 0)])
def test_who_takes_more_room_has_to_leave_it_to_the_fail_safe(x, count):
    """One that leaves its lane for the ego's, at no more than its own speed."""
    shield = ShieldCore()
    after(shield, scene_of((0, 0, 0, 20), (x, 2.9, 0, 10), lanes=2))
    after(shield, scene_of((20 * DT, 0, 0, 20), (x + 10 * DT, 2.4, 0, 10), lanes=2))
    assert shield.violations == count
    assert shield.watch.by_rule == ({Rule.LANES: 1} if count else {})


@pytest.mark.parametrize(("r", "y", "count"), [(-0.9, 1.6, 1), (4.0, 0.0, 0)])
def test_who_owes_the_ego_its_distance_does_not_come_beside_it(r, y, count):
    """From behind an ego at rest to beside it, outside of its buffer: in its own lane, or in the next one."""
    shield = ShieldCore()
    for x in (-7.2, -7.2 + 15 * DT):
        shield.look(scene_of((0, r, 0, 0), (x, y, 0, 15), lanes=2))
    assert shield.violations == count
    assert shield.watch.by_rule == ({Rule.DISTANCE: 1} if count else {})
