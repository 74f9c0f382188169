"""Entering vehicles: vehicles that may come into a lane of the ego's plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from clause_scenes import CONFIG, DT, clear, scene_of
from cores import ShieldCore


def test_a_vehicle_beyond_the_entered_lane_may_enter_it_too():
    blind = CONFIG.replace(assumptions=replace(CONFIG.assumptions, simultaneous_merge=False))
    slow = 30, 8, 0, 10
    for at in (8, -3):
        held_up = scene_of((0, 0, 0, 20), (at, 8, 0, 15), slow)
        assert clear(held_up, 1) < 0 <= clear(held_up, 1, config=blind)
    # The lane that the fail-safe would return to as well.
    returning = scene_of((0, 8, 0, 20), (-3, 0, 0, 20), (20, 0, 0, 10))
    assert clear(returning, 2, fail=1) < 0 <= clear(returning, 2)


def test_a_vehicle_that_loses_by_a_lane_change_does_not_enter():
    leader = 60, 4, 0, 15
    beyond = (0, 0, 0, 20), (8, 8, 0, 15)
    assert clear(scene_of(*beyond), 1) < 0 <= clear(scene_of(*beyond, leader), 1)
    # A vehicle on its way into the lane enters it.
    assert clear(scene_of((0, 0, 0, 20), (8, 8, -0.05, 15), leader), 1) < 0


def test_no_entrant_is_added_once_a_plan_stops_in_the_lane():
    held_up = scene_of((0, 0, 0, 20), (8, 8, 0, 15), (30, 8, 0, 10))
    nobody = np.zeros((4, 2), dtype=bool)
    assert clear(held_up, 1, coming=nobody) < 0 <= clear(held_up, 1, coming=nobody, stored=1)
    # Except for a lane from which the ego gets out of sight meanwhile.
    seen = np.array([1000, 1000, 0, 0])
    leaving = scene_of((0, 1.2, -0.3, 20), (8, 8, 0, 15), (30, 8, 0, 10))
    assert clear(leaving, 0, fail=1, coming=nobody, stored=1, visible=seen) < 0


def test_a_vehicle_that_is_changing_lanes_may_enter_until_the_ego_has_been_visible_long_enough():
    visible = np.array([1, 1, 0, 0])
    straight, turning = (scene_of((0, 2.5, 0, 15), (6, 8, psi, 15)) for psi in (0.0, -0.03))
    visible[1] = 4
    assert clear(turning, 1, visible=visible) < 0 <= clear(straight, 1, visible=visible)
    assert clear(turning, 1, visible=visible + 1000) >= 0


def test_any_vehicle_may_enter_a_lane_from_which_the_ego_is_not_visible():
    """The ego has a plan to stop in lane 1, where it is out of sight; no vehicle has a lane-change incentive to go
    there."""
    for r, comes in ((5.5, False), (7.2, True)):
        core = ShieldCore()
        core.observe(scene_of((0, 5.4, 0, 10), (20, 0, 0, 10)))
        core.stored = 1
        assert (
            core.observe(scene_of((10 * DT, r, 0, 10), (20 + 10 * DT, 0, 0, 10))).verifier.others.comes[1, 0] == comes
        )
