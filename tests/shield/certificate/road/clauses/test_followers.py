"""Followers: vehicles behind the ego that have to keep their distance, and those that do not."""

from __future__ import annotations

import numpy as np
import pytest
from clause_scenes import CONFIG, DT, along, clear, driven, extents, scene_of, verifier_of
from cores import ShieldCore

from dynamics.traffic.assumptions import Assumptions

PUSHES = [("idm", 15, 20), ("rss", 25, 20), ("idm", 20, 40)]
PUSHES += [("rss", 15, 20)]


def leaning(v):
    return [[v * DT * k, 1.6, 0.0, v] for k in range(1, 20)]


def passing(*across):
    """A path at 5 m/s that is so far across the road in its first frames, and stays at the last of them."""
    r = [*across, *[across[-1]] * 20]
    return [[5.0 * DT * k, r[k - 1], 0.0, 5.0] for k in range(1, len(r))]


@pytest.mark.parametrize("begins", [0.0, 1.5])
@pytest.mark.parametrize(("profile", "v", "fast"), PUSHES)
def test_a_follower_that_accelerates_until_its_reaction_time_ends_does_not_touch(profile, v, fast, begins):
    """The ego changes lanes; one behind there accelerates until it has seen it for the reaction time."""
    a = Assumptions.profile(profile)
    config, reaction = CONFIG.replace(assumptions=a), int(np.ceil(a.reaction_time / DT - 1e-9))
    accepted = 0
    for gap in np.arange(6.0, 150.0, 0.5):
        scene = scene_of((0, begins, 0, v), (-gap, 4, 0, fast), lanes=2)
        if clear(scene, 1, config=config) < 0:
            continue
        accepted += 1
        path = driven(scene, 1)
        s, u, since, r, k = -gap, float(fast), 0, begins, 0
        while k < len(path) or u > 0:
            state = path[min(k, len(path) - 1)]
            since = since + 1 if abs(r - 4) <= 3 else 0
            rate = (
                -a.follower_braking
                if since > reaction
                else min(a.acceleration, a.power / max(u, 1e-3), (max(a.max_speed, fast) - u) / DT)
            )
            s, u, r, k = s + u * DT, max(u + rate * DT, 0.0), state[1], k + 1
            half_s, half_r = extents(state)
            if state[1] + half_r > 3:
                assert state[0] - half_s - (s + 2.5) >= -1e-9, (gap, k)
    assert 0 < accepted < 288


def test_a_follower_owes_its_distance_in_the_lane_of_the_ego_only():
    behind = scene_of((0, 0, 0, 5), (-12, 0, 0, 25))
    assert along(behind, leaning(5.0), 0) == np.inf
    assert along(scene_of((0, 0, 0, 5), (12, 0, 0, 0)), leaning(5.0), 0) < 0
    # In a lane that the ego leans into and does not own.
    other = scene_of((0, 1.0, 0, 5), (-12, 4, 0, 25))
    assert along(other, leaning(5.0), 0) < 0
    # In the ego's lane and in the entered lane.
    both = scene_of((0, 0, 0, 5), (-12, 2.2, 0, 25))
    assert clear(both, 1) < 0


def test_no_follower_owes_distance_in_a_lane_that_the_ego_left_and_entered_again():
    behind = scene_of((0, 0, 0, 5), (-12, 0, 0, 25))
    for path, owed in (([0.0], True), ([0.0, 1.5, 0.0], True), ([0.0, 4.0], True), ([0.0, 4.0, 0.0], False)):
        assert (along(behind, passing(*path)) == np.inf) == owed
    assert along(behind, passing(0.0, 4.0, 0.0)) < 0


def test_a_follower_owes_its_distance_until_the_ego_has_left_its_strip():
    """The ego has left its old lane for the next one, but for a corner that still touches the strip of one behind."""
    for r, duty in ((2.4, True), (2.7, False)):
        scene = scene_of((0, r, 0, 5), (-12, 0, 0, 25))
        marks = {"owned": [False, True, False, False]}
        held = [
            verifier_of(scene, CONFIG, followers=np.array([f]), **marks).others.in_owned_lane[0] for f in (False, True)
        ]
        assert held == [False, duty]
    scene = scene_of((0, 2.4, 0, 5), (-12, 0, 0, 25))
    assert along(scene, passing(2.4), 1, **marks) < 0
    assert along(scene, passing(2.4), 1, followers=np.array([True]), **marks) == np.inf


@pytest.mark.parametrize(("front", "owed", "behind"), [(-4.6, True, True), (-4.6, False, False), (-4.4, True, False)])
def test_a_follower_is_behind_until_it_touches_the_buffer(front, owed, behind):
    """Beside the rearmost corner of a turned ego; the other corner of its buffer is further ahead."""
    scene = scene_of((0, 0, 0.3, 5), (front - 2.5, -1.6, 0, 5))
    assert 4.5 * np.cos(0.3) + 1.3 * np.sin(0.3) > 4.6
    assert verifier_of(scene, CONFIG, followers=np.array([owed])).others.behind[0] == behind


def test_a_lane_is_owned_only_with_a_verified_plan_and_while_the_ego_touches_it():
    for stored, r, owned in ((0, 2.0, [1, 0]), (1, 2.0, [1, 1]), (1, 4.0, [0, 1])):
        core = ShieldCore()
        core.supervise(scene_of((0, 0, 0, 10), lanes=2))
        core.stored = stored
        scene = scene_of((1, r, 0.1, 10), lanes=2)
        assert list(core.observe(scene).verifier.owned) == owned
