"""The monitor, and the stored plan that outlives a violation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from clause_scenes import DT, after, along, braked, scene_of
from cores import ContinuousCore, ShieldCore

from dynamics.traffic.rules_of_the_road import RoadRule
from shield import Tier


@pytest.mark.parametrize("core", [ShieldCore, ContinuousCore])
def test_a_violation_is_counted_and_the_stored_plan_outlives_it(core):
    """A vehicle jumps in ahead of the ego; the plan for the leader still holds, and is kept."""
    shield = core()
    start = scene_of((0, 0, 0, 20), (30, 4, 0, 20), (90, 0, 0, 20), lanes=1 + 1)
    assert after(shield, start).tier.verified
    decision = after(shield, scene_of((20 * DT, 0, 0, 20), (10, 1.0, 0, 5), (90 + 20 * DT, 0, 0, 20), lanes=2))
    assert shield.violations == 1
    assert shield.watch.violated
    assert decision.tier in (Tier.EVADED, Tier.STORED_PLAN)


@pytest.mark.parametrize("core", [ShieldCore, ContinuousCore])
def test_violations_are_cleared_once_a_plan_clears_all_vehicles(core):
    """One far ahead stops at once: there is room for that."""
    shield = core()
    before, now = scene_of((0, 0, 0, 10), (60, 0, 0, 20)), scene_of((10 * DT, 0, 0, 10), (60 + 20 * DT, 0, 0, 0))
    after(shield, before)
    assert shield.observe(now).memory.watch.violated
    shield.reset()
    assert after(shield, before, now).tier.verified
    assert shield.violations == 1
    assert not shield.watch.violated


@pytest.mark.parametrize("core", [ShieldCore, ContinuousCore])
def test_a_scene_observed_twice_counts_as_one_frame(core):
    """Neither the visibility clock nor the count of violations advances: an unmoved vehicle has not stood still."""
    shield = core()
    for k in range(3):
        scene = scene_of((20 * DT * k, 0, 0, 20), (60 + 20 * DT * k, 0, 0, 20))
        first, again = (shield.observe(replace(scene, frame=k)) for _ in range(2))
        np.testing.assert_array_equal(first.verifier.visible, again.verifier.visible)
    assert shield.violations == 0


@pytest.mark.parametrize("core", [ShieldCore, ContinuousCore])
def test_a_stored_plan_is_recorded_with_its_own_margin(core):
    """A vehicle appears at once, without a known violation, and leaves no plan; the largest margin is that of
    another input."""
    shield = core()
    assert after(shield, scene_of((0, 0, 0, 10), lanes=3)).tier.verified
    scene = scene_of((10 * DT, 0, 0, 10), (10.4, 0, 0, 0), (19.5, 0, 0, 19), lanes=3)
    scene = replace(scene, observed=True)
    decision = after(shield, scene)
    assert decision.tier is Tier.STORED_PLAN
    assert decision.margin == pytest.approx(along(scene, braked(scene)))


@pytest.mark.parametrize(("x", "count"), [(12.0, 1), (90.0, 0)])
def test_a_vehicle_that_takes_more_room_is_a_violator_if_the_fail_safe_needs_it(x, count):
    """A vehicle leaves its lane for the ego's, at no more than its own speed."""
    shield = ShieldCore()
    after(shield, scene_of((0, 0, 0, 20), (x, 2.9, 0, 10), lanes=2))
    after(shield, scene_of((20 * DT, 0, 0, 20), (x + 10 * DT, 2.4, 0, 10), lanes=2))
    assert shield.violations == count
    assert shield.watch.by_rule == ({RoadRule.LANES: 1} if count else {})


@pytest.mark.parametrize(("r", "y", "count"), [(-0.9, 1.6, 1), (4.0, 0.0, 0)])
def test_a_follower_that_owes_distance_does_not_come_beside_the_ego(r, y, count):
    """From behind an ego at rest to beside it, outside of its buffer: in its own lane, or in the next one."""
    shield = ShieldCore()
    for x in (-7.2, -7.2 + 15 * DT):
        shield.observe(scene_of((0, r, 0, 0), (x, y, 0, 15), lanes=2))
    assert shield.violations == count
    assert shield.watch.by_rule == ({RoadRule.DISTANCE: 1} if count else {})
