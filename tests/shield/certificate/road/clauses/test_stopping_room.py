"""Stopping room: a plan ends inside its lane."""

from __future__ import annotations

import numpy as np
import pytest
from clause_scenes import margin, scene_of

from shield.certificate.road.clauses.footprint import Footprint
from shield.certificate.road.clauses.stopping_room import room_of


def test_a_plan_ends_inside_its_lane():
    assert margin(scene_of((0, 0.6, 0, 0)), 0) >= 0
    assert margin(scene_of((0, 0.8, 0, 0)), 0) < 0


@pytest.mark.parametrize(("overshoot", "room"), [(-1.0, 0.5), (0.0, 0.5), (0.2, 0.5), (0.7, 0.1)])
def test_a_plan_leaves_straight_motion_in_the_lane_beside_its_room(overshoot, room):
    path, turned = np.array([[0.0, 0.2, 0.0, 0.0]]), np.array([[0.0], [1.0]])
    size = Footprint(4.5, 1.3, 5.0, 2.0)
    assert room_of.py_func(path, turned, size, 0.0, 2.0, overshoot) == pytest.approx(room)
