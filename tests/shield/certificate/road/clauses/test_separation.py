"""Separation: distance between the ego's plan and the reachable intervals of the other vehicles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from clause_scenes import CONFIG, DT, along, braking, clear, driven, margin, scene_of

from shield import Buffer

HELD_UP = CONFIG.replace(assumptions=replace(CONFIG.assumptions, comfortable_braking=6.0))


def beside(psi, at):
    """A path that points at the car beside in frame `at`, and nowhere else."""
    path = np.array([[4.0 * k, 0.05, 0.0, 20.0] for k in range(1, 5)])
    path[at, 2] = psi
    return path


@pytest.mark.parametrize("config", [CONFIG, HELD_UP])
@pytest.mark.parametrize(("v", "leader"), [(10.0, 10.0), (25.0, 15.0)])
def test_a_leader_that_brakes_and_turns_within_its_limits_is_not_touched(v, leader, config):
    """The leader turns as soon as it is slow, and again with the room that has come back since."""
    accepted, least = 0, np.inf
    for gap in np.arange(8.0, 60.0, 0.1):
        scene = scene_of((0, 0, 0, v), (gap, 0, 0, leader))
        if margin(scene, 0, config=config) < 0:
            continue
        accepted += 1
        s, u, lost, spent, k = gap, leader, 0.0, 0.0, 0
        for state in driven(scene, 0):
            turned = 0.0
            if u < 5.5:
                turned = min(u * DT, 1.47 + 0.5 * k * DT - lost, (8.6 + 6 * k * DT - spent) / max(u, 1e-9))
            rate, k = (6 if k >= 45 or config is HELD_UP else 3), k + 1
            s, u, lost, spent = s + u * DT - turned, max(u - rate * DT, 0.0), lost + turned, spent + u * turned
            least = min(least, s - 2.5 - (state[0] + 4.5))
            assert s - 2.5 - (state[0] + 4.5) >= -1e-9, gap
    assert 0 < accepted < 520
    assert least < 4.0


def test_the_buffer_is_kept_along_and_across_the_road():
    bare = CONFIG.replace(buffer=Buffer(0.0, 0.0))
    ahead, beside = scene_of((0, 0, 0, 0), (7, 0, 0, 0)), scene_of((0, 1.2, 0, 0), (0, 4, 0, 0))
    for scene, room in ((ahead, 2.0), (beside, 0.3)):
        clear = (braking(scene, 0, config=c).separations.min() for c in (bare, CONFIG))
        assert next(clear) - next(clear) == pytest.approx(room)


def test_a_vehicle_that_stands_in_a_queue_may_reverse():
    """With a standing vehicle 6 m ahead of it, by another 8 m."""
    assert margin(scene_of((0, 0, 0, 0), (14, 0, 0, 0)), 0) > 6
    assert margin(scene_of((0, 0, 0, 0), (14, 0, 0, 0), (20, 0, 0, 0)), 0) < 0


def test_a_body_beyond_the_lane_marking_may_return():
    scene = scene_of((0, 0, 0, 10), (1, 2.4, 0, 10), dt=0.1)
    assert clear(scene, 0) < 0


@pytest.mark.parametrize("at", [0, 1])
def test_the_next_frame_at_constant_velocity_is_clear_too(at):
    """highway-env counts as a collision an overlap that constant velocity would bring within a frame."""
    scene = scene_of((0, 0, 0, 20), (2.0, 4, 0, 20), lanes=2, dt=0.2)
    assert along(scene, beside(0.0, at)) >= 0
    assert along(scene, beside(0.3, at)) < 0
