"""The geometry of road networks equals highway-env's, on every lane of every road."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from highway_env.road.lane import CircularLane, PolyLane, SineLane
from highway_env.road.road import RoadNetwork
from hypothesis import given, settings
from hypothesis import strategies as st
from road_geometries import EACH, numbers, read

from dynamics.errors import ConfigError, SceneError
from dynamics.road_networks.geometry.road_geometry import RoadGeometry

HALF_TURN = 0.999 * np.pi
SHARE = st.floats(0, 1)


def projected(road, lane):
    """The greatest s that a projection gives on a lane [m]."""
    lane = road.lanes_list()[lane]
    return min(lane.length, HALF_TURN * lane.radius) if isinstance(lane, CircularLane) else lane.length


# -- on a lane -------------------------------------------------------------------------------------------


@EACH
@settings(max_examples=20, deadline=None)
@given(along=SHARE, across=st.floats(-0.5, 0.5))
def test_projection_inverts_placement(env_id, along, across):
    road, geometry = read(env_id)
    every = numbers(geometry)
    s, r = along * np.array([projected(road, k) for k in every]), across * geometry.widths
    back = geometry.project(every, *geometry.position(every, s, r))
    assert np.allclose(back, (s, r), rtol=0, atol=1e-6)


@EACH
@settings(max_examples=10, deadline=None)
@given(along=SHARE)
def test_the_curvature_is_the_change_of_heading(env_id, along):
    geometry = read(env_id)[1]
    every, step = numbers(geometry), 1e-3
    s = along * geometry.lengths
    (x0, y0), (x1, y1) = (geometry.position(every, s + d) for d in (-step, step))
    turned = geometry.heading(every, s + step) - geometry.heading(every, s - step)
    assert np.allclose(geometry.curvature(every, s), turned / np.hypot(x1 - x0, y1 - y0), rtol=0, atol=1e-6)


@settings(max_examples=50, deadline=None)
@given(
    amplitude=st.floats(-5, 5),
    pulsation=st.floats(-0.2, 0.2),
    phase=st.floats(-7, 7),
    end=st.tuples(st.floats(5, 200), st.floats(-200, 200)),
    along=SHARE,
    r=st.floats(-2, 2),
)
def test_any_sine_is_highway_envs(amplitude, pulsation, phase, end, along, r):
    road = RoadNetwork()
    lane = SineLane([0.0, 0.0], list(end), amplitude, pulsation, phase)
    road.add_lane("a", "b", lane)
    geometry, s, step = RoadGeometry.of(road), along * lane.length, 1e-3
    assert np.allclose(geometry.position(0, s, r), lane.position(s, r), rtol=0, atol=1e-6)
    assert np.allclose(geometry.project(0, *lane.position(s, r)), (s, r), rtol=0, atol=1e-6)
    way = np.hypot(*(lane.position(s + step, 0) - lane.position(s - step, 0)))
    turned = lane.heading_at(s + step) - lane.heading_at(s - step)
    assert abs(geometry.curvature(0, s) - turned / way) < 1e-6


@EACH
def test_every_lane_is_highway_envs(env_id):
    """On it, beside it and beyond its ends."""
    (road, geometry), rng = read(env_id), np.random.default_rng(1)
    assert geometry.names == tuple(road.lanes_dict())
    assert np.array_equal(geometry.lengths, [lane.length for lane in road.lanes_list()])
    for _ in range(6):
        s, r = rng.uniform(-20, geometry.lengths + 20), rng.uniform(-9, 9, len(geometry.names))
        at = np.array([lane.position(*each) for lane, *each in zip(road.lanes_list(), s, r, strict=True)])
        assert np.allclose(np.column_stack(geometry.position(numbers(geometry), s, r)), at, rtol=0, atol=1e-6)
        back = [lane.local_coordinates(each) for lane, each in zip(road.lanes_list(), at, strict=True)]
        assert np.allclose(np.column_stack(geometry.project(numbers(geometry), *at.T)), back, rtol=0, atol=1e-6)
        headings = [lane.heading_at(each) for lane, each in zip(road.lanes_list(), s, strict=True)]
        assert np.allclose(geometry.heading(numbers(geometry), s), headings, rtol=0, atol=1e-6)
        widths = [lane.width_at(each) for lane, each in zip(road.lanes_list(), s, strict=True)]
        assert np.allclose(geometry.widths, widths, rtol=0, atol=1e-6)


@EACH
def test_the_closest_lane_is_highway_envs(env_id):
    (road, geometry), rng = read(env_id), np.random.default_rng(2)
    lane = rng.integers(len(geometry.names), size=30)
    x, y = geometry.position(lane, rng.uniform(-20, geometry.lengths[lane] + 20), rng.uniform(-9, 9, 30))
    heading = rng.uniform(-7, 7, 30)
    found = geometry.closest(x, y, heading)
    names = [road.get_closest_lane_index(np.array(at), psi) for *at, psi in zip(x, y, heading, strict=True)]
    assert [geometry.names[k] for k in found.lane] == names
    assert np.array_equal((found.s, found.r), geometry.project(found.lane, x, y))


def test_a_right_turn_has_a_positive_curvature():
    road = RoadNetwork()
    road.add_lane("a", "b", CircularLane([0.0, 0.0], 10.0, 0.0, 1.0, clockwise=True))
    road.add_lane("a", "c", CircularLane([0.0, 0.0], 10.0, 0.0, -1.0, clockwise=False))
    geometry = RoadGeometry.of(road)
    assert geometry.curvature([0, 1], 3.0).tolist() == [0.1, -0.1]
    _, r = geometry.project([0, 1], 0.0, 0.0)  # the centre
    assert r.tolist() == [10.0, -10.0]


@EACH
def test_the_outline_is_the_edges(env_id):
    geometry = read(env_id)[1]
    for lane in numbers(geometry):
        first, last = 0.2 * geometry.lengths[lane], 0.7 * geometry.lengths[lane]
        outline = geometry.outline(lane, first, last)
        s, r = geometry.project(lane, *outline.T)
        assert np.allclose(abs(r), geometry.widths[lane] / 2)
        assert np.allclose((s.min(), s.max()), (first, last))
        assert np.allclose(s, np.concatenate([s[: len(s) // 2], s[: len(s) // 2][::-1]]))


# -- inputs ----------------------------------------------------------------------------------------------


def test_shapes_broadcast():
    geometry = read("roundabout-v0")[1]
    s, r = geometry.project(np.arange(3)[:, None], np.zeros(4), 1.0)
    assert s.shape == r.shape == (3, 4)
    x, _ = geometry.position(2, 1.0)
    assert x.shape == geometry.heading(2, 1.0).shape == geometry.closest(0.0, 0.0, 0.0).s.shape == ()
    assert geometry.position(np.array([], int), [])[0].shape == (0,)


def test_unsupported_networks_are_refused():
    bent = RoadNetwork()
    bent.add_lane("a", "b", PolyLane([(0.0, 0.0), (5.0, 1.0), (9.0, 0.0)], [(0, 2), (9, 2)], [(0, -2), (9, -2)]))
    with pytest.raises(SceneError, match="StraightLane, SineLane, CircularLane, not PolyLane"):
        RoadGeometry.of(bent)
    with pytest.raises(SceneError, match="no lanes"):
        RoadGeometry.of(RoadNetwork())
    with pytest.raises(ConfigError, match="not CartPoleEnv"):
        RoadGeometry.of(gym.make("CartPole-v1", disable_env_checker=True))


@pytest.mark.parametrize("lane", [-1, 9, 0.0, [0, 9], True])
def test_lanes_that_do_not_exist_are_refused(lane):
    geometry = read("merge-v0")[1]
    with pytest.raises(ConfigError, match="numbers 0 to 8"):
        geometry.position(lane, 0.0)


@pytest.mark.parametrize("ask", ["successors", "neighbours", "merges_into", "outline"])
def test_a_lane_that_does_not_exist_is_refused(ask):
    with pytest.raises(ConfigError, match="numbers 0 to 8"):
        getattr(read("merge-v0")[1], ask)(9)


def test_names_shapes_and_numbers_that_are_wrong_are_refused():
    geometry = read("merge-v0")[1]
    with pytest.raises(ConfigError, match=r"no lane \('a', 'z', 0\); have \('a', 'b', 0\)"):
        geometry.number(("a", "z", 0))
    with pytest.raises(ConfigError, match="broadcast"):
        geometry.project([0, 1], [0.0, 1.0, 2.0], 0.0)
    with pytest.raises(ConfigError, match="finite"):
        geometry.closest(np.nan, 0.0, 0.0)


def test_the_example_of_the_page_runs():
    page = (Path(__file__).parents[4] / "docs" / "lab" / "roads.md").read_text(encoding="utf-8")
    (block,) = (each for each in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "RoadGeometry" in each)
    names = {}
    exec(compile(block, "roads.md", "exec"), names)
    assert names["zones"]
    assert all(first.lane <= second.lane for first, second in pairwise(names["zones"]))
