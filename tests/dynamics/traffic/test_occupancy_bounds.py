"""Bounds of the reachable intervals of single vehicles on a straight road."""

from __future__ import annotations

import numpy as np
import pytest
from clause_scenes import BODY, CONFIG, DT

from dynamics.roads.straight import StraightRoad
from dynamics.traffic.assumptions import Assumptions
from dynamics.traffic.occupancy import OtherVehicles


@pytest.mark.parametrize(("ahead", "calm"), [((), 45), ((35.0,), 0), ((600.5,), 45)])
@pytest.mark.parametrize("frames", [8, 80])
def test_the_rear_bound_is_that_of_a_braking_vehicle(frames, ahead, calm):
    """In each frame; the last column stands for all the rest. On a free road it does not brake hard for three
    seconds."""
    rows = np.array([[0.0, 0.0, 0.0, 20.0, *BODY], *([s, 0.0, 0.0, 0.0, *BODY] for s in ahead)])
    around = OtherVehicles(rows, rows[:, :4], StraightRoad.from_lanes(1), CONFIG.assumptions, DT)
    bound = around.rear(frames)[0]
    rates = np.where(np.arange(80) < calm, 3.0, 6.0)
    way = np.cumsum(np.maximum(20.0 - np.cumsum([0.0, *rates[:-1]]) * DT, 0.0)) * DT
    assert (bound[:-1] <= way[: frames - 1] - 2.5 + 1e-9).all()
    assert bound[-1] <= way[-1] - 2.5
    assert around.bodies.floor[0] <= way[-1]
    # And no further back than turning may cost, and the diagonal.
    assert (bound[: min(frames - 1, 25)] >= way[: min(frames - 1, 25)] - 2.7 - 2.5).all()


def test_the_last_frame_of_the_bound_holds_for_all_later_frames():
    """A vehicle that stands 6 m behind another may reverse until it is 8 m away from it."""
    rows = np.array([[s, 0.0, 0.0, 0.0, *BODY] for s in (14.0, 20.0)])
    around = OtherVehicles(rows, rows[:, :4], StraightRoad.from_lanes(1), CONFIG.assumptions, DT)
    rears = [around.rear(frames)[0] for frames in (3, 200)]
    for rear in rears:
        assert rear[-1] <= rear[0] - 1.5
        assert rear[-1] == pytest.approx(rears[1].min())
    assert rears[0][1] > rears[0][-1] + 1


def test_a_body_reaches_as_far_as_its_heading_leads():
    rows = np.array([[0.0, 3.4, -0.15, 20.0, *BODY]])
    around = OtherVehicles(rows, rows[:, :4], StraightRoad.from_lanes(2), Assumptions.idm(), 0.2)
    assert around.low[0] <= 4 - 0.6 - 20 * np.sin(0.15) * 0.2 - 1.36 + 1e-3
    assert around.low[0] < -1


def test_a_turned_body_extends_along_the_road_by_its_diagonal():
    turned = np.arctan2(2, 5)
    rows = np.array([[0.0, 0.0, turned, 0.0, *BODY]])
    around = OtherVehicles(rows, rows[:, :4], StraightRoad.from_lanes(1), Assumptions.idm(), DT)
    assert around.rear(1)[0, 0] <= -2.5 * np.cos(turned) - np.sin(turned) + 1e-9
