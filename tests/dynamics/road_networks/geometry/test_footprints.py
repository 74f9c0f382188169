"""The extent of a rectangle on a lane is that of its outline in highway-env's lane coordinates."""

from __future__ import annotations

import math

import numpy as np
import pytest
from highway_env.road.lane import CircularLane, SineLane, StraightLane
from highway_env.road.road import RoadNetwork
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.highway_simulator.arithmetic import sums_of_numpy
from dynamics.highway_simulator.loops import addresses
from dynamics.road_networks.geometry.footprints import LanePoint, Rectangle, extent_of
from dynamics.road_networks.geometry.lanes import NetworkLanes
from dynamics.road_networks.geometry.network import network_of

SIDE = np.linspace(-1.0, 1.0, 201)
OUTLINE = np.concatenate(
    [np.stack([SIDE, SIDE * 0 + k], 1) for k in (-1, 1)] + [np.stack([SIDE * 0 + k, SIDE], 1) for k in (-1, 1)]
)
STRAIGHT = st.builds(
    lambda angle: StraightLane([3.0, -4.0], [3.0 + 40 * math.cos(angle), -4.0 + 40 * math.sin(angle)]), st.floats(-3, 3)
)
SINE = st.builds(
    lambda angle, *shape: SineLane([3.0, -4.0], [3.0 + 40 * math.cos(angle), -4.0 + 40 * math.sin(angle)], *shape),
    st.floats(-3, 3),
    st.floats(-5, 5),
    st.floats(-0.2, 0.2),
    st.floats(-3, 3),
)
ARC = st.builds(
    lambda radius, start, turn: CircularLane([3.0, -4.0], radius, start, start + turn, clockwise=turn > 0),
    st.floats(9, 40),
    st.floats(-3, 3),
    st.one_of(st.floats(0.3, 3), st.floats(-3, -0.3)),
)


def lanes_of(lane):
    road = RoadNetwork()
    road.add_lane("a", "b", lane)
    network = network_of(road)
    return NetworkLanes(sums_of_numpy()[0], addresses(), network.lanes, network.ids, network.near)


@pytest.mark.parametrize("kind", [STRAIGHT, SINE, ARC], ids=["straight", "sine", "arc"])
@settings(max_examples=150, deadline=None)
@given(
    data=st.data(),
    share=st.floats(0, 1),
    r=st.floats(-4, 4),
    angle=st.floats(-math.pi, math.pi),
    ahead=st.sampled_from([0.0, 1.5, -0.5]),
    sides=st.tuples(st.floats(0.2, 6.0), st.floats(0.2, 1.5)),
)
def test_the_extent_of_a_rectangle_is_that_of_its_outline(kind, data, share, r, angle, ahead, sides):
    """No point of the outline is outside, and the extent exceeds the outline by no more than the sampling error."""
    lane = data.draw(kind)
    s = share * (min(lane.length, 0.9 * math.pi * lane.radius) if isinstance(lane, CircularLane) else lane.length)
    (x, y), heading = lane.position(s, r), lane.heading_at(s) + angle
    cos, sin = math.cos(heading), math.sin(heading)
    extent = extent_of(lanes_of(lane), 0, LanePoint(float(x), float(y), s, r), Rectangle(ahead, cos, sin, *sides))
    points = [x, y] + (OUTLINE * sides + [ahead, 0.0]) @ np.array([[cos, sin], [-sin, cos]])
    local = np.array([lane.local_coordinates(point) for point in points])
    least, most = local.min(axis=0), local.max(axis=0)
    outside = np.array([extent.first - least[0], most[0] - extent.last, extent.low - least[1], most[1] - extent.high])
    assert outside.max() <= 1e-9
    assert outside.min() >= -1e-3
