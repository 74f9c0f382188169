"""Links between the lanes of a road network: successors as in highway-env, and neighbours."""

from __future__ import annotations

import numpy as np
from road_geometries import EACH, read

from dynamics.road_networks.geometry.road_geometry import Neighbours
from dynamics.state import wrap_to_pi

UNCONNECTED = ("highway-", "two-way-", "parking-", "lane-keeping-")
"""Roads that nothing goes on from, or not where they end."""


@EACH
def test_a_successor_continues_its_lane(env_id):
    """In place and heading within 1e-6. On racetracks, whose sections do not meet exactly, within 0.25 m across and
    0.13 rad. Successors that begin within 3 m and 0.3 rad of the lane's end count."""
    geometry, joints = read(env_id)[1], 0
    racetrack = env_id.startswith("racetrack")
    for lane, length in enumerate(geometry.lengths):
        end, heading = geometry.position(lane, length), geometry.heading(lane, length)
        for after in geometry.successors(lane):
            assert geometry.names[after][0] == geometry.names[lane][1]
            away = np.hypot(*np.subtract(geometry.position(after, 0.0), end))
            if away > 3.0 or abs(wrap_to_pi(geometry.heading(after, 0.0) - heading)) > 0.3:
                continue
            joints += 1
            s, r = geometry.project(after, *end)
            turned = abs(wrap_to_pi(geometry.heading(after, s) - heading))
            assert (abs(r) < 0.25 and turned < 0.13) if racetrack else (away < 1e-6 and turned < 1e-6)
    assert joints or env_id.startswith(UNCONNECTED)


@EACH
def test_the_next_lane_of_highway_env_is_among_the_successors(env_id):
    """Unless the road only turns back."""
    road, geometry = read(env_id)
    for lane, name in enumerate(geometry.names):
        end, heading = geometry.position(lane, geometry.lengths[lane]), geometry.heading(lane, geometry.lengths[lane])
        after = geometry.number(road.next_lane(name, position=np.array(end)))
        if after != lane and np.cos(geometry.heading(after, 0.0) - heading) > 0:
            assert after in geometry.successors(lane)
        else:
            assert not geometry.successors(lane)


@EACH
def test_neighbours_are_to_the_left_and_to_the_right(env_id):
    road, geometry = read(env_id)
    for lane, name in enumerate(geometry.names):
        sides = geometry.neighbours(lane)
        beside = {geometry.names[k] for k in sides if k is not None}
        assert beside == set(road.side_lanes(name))
        for side, sign in zip(sides, (-1, 1), strict=True):
            if side is not None:
                _, r = geometry.project(lane, *geometry.position(side, geometry.lengths[side] / 3))
                assert sign * r > 0.5
                assert lane in geometry.neighbours(side)


def test_a_ramp_merges_into_its_neighbour():
    geometry = read("merge-v1")[1]
    ramp = geometry.number(("b", "c", 2))
    assert geometry.merges_into(ramp) == geometry.number(("b", "c", 1)) == geometry.neighbours(ramp).left
    assert [geometry.merges_into(k) for k in range(len(geometry.names))].count(None) == len(geometry.names) - 1
    assert geometry.neighbours(0) == Neighbours(None, 1)
