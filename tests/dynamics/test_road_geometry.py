"""The geometry of road networks is highway-env's, on every lane of every road, and it knows where lanes meet."""

from __future__ import annotations

import re
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from highway_env.road.lane import CircularLane, PolyLane, SineLane, StraightLane
from highway_env.road.road import RoadNetwork
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.errors import ConfigError, SceneError
from dynamics.networks.conflicts import Meeting
from dynamics.networks.geometry import Neighbours, RoadGeometry
from dynamics.state import wrap_to_pi

COMPLEX = "evaluation.scenarios:ComplexRoads-v0"
ENVIRONMENTS = (*sorted(k for k, spec in gym.registry.items() if "highway_env" in str(spec.entry_point)), COMPLEX)
EACH = pytest.mark.parametrize("env_id", ENVIRONMENTS)
UNCONNECTED = ("highway-", "two-way-", "parking-", "lane-keeping-")
"""Roads that nothing goes on from, or not where they end."""
APART = ("highway-", "merge-", "exit-", "u-turn-", "racetrack-", "parking-", "lane-keeping-")
"""Roads of which no lanes overlap: those of highway-env's merges run beside each other until one ends."""
HALF_TURN = 0.999 * np.pi
SHARE = st.floats(0, 1)


@lru_cache
def read(env_id):
    """The network of an environment, and its geometry."""
    env = gym.make(env_id)
    env.reset(seed=0)
    return env.unwrapped.road.network, RoadGeometry.of(env)


def numbers(geometry):
    return np.arange(len(geometry.names))


def projected(road, lane):
    """The greatest s that a projection gives on a lane [m]."""
    lane = road.lanes_list()[lane]
    return min(lane.length, HALF_TURN * lane.radius) if isinstance(lane, CircularLane) else lane.length


# -- on a lane -------------------------------------------------------------------------------------------


@EACH
@settings(max_examples=20, deadline=None)
@given(along=SHARE, across=st.floats(-0.5, 0.5))
def test_what_is_placed_is_projected_back(env_id, along, across):
    road, geometry = read(env_id)
    every = numbers(geometry)
    s, r = along * np.array([projected(road, k) for k in every]), across * geometry.widths
    back = geometry.project(every, *geometry.position(every, s, r))
    assert np.allclose(back, (s, r), rtol=0, atol=1e-6)


@EACH
@settings(max_examples=10, deadline=None)
@given(along=SHARE)
def test_the_curvature_is_how_the_heading_changes(env_id, along):
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


def test_who_turns_right_has_a_positive_curvature():
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


# -- from lane to lane -----------------------------------------------------------------------------------


@EACH
def test_a_lane_goes_over_into_those_that_continue_it(env_id):
    """In place and heading within 1e-6, and on racetracks, whose sections do not meet exactly, within 0.25 m across and
    0.13 rad. Of those that go on from it, the ones count that begin within 3 m and in its direction within 0.3 rad."""
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
def test_where_highway_env_goes_on_is_among_the_successors(env_id):
    """Unless the road only leads back."""
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


# -- conflict zones --------------------------------------------------------------------------------------


def inside(geometry, lanes, x, y, margin):
    """Whether places are on the lanes, or no further out than the margin [m]."""
    s, r = geometry.project(lanes, x, y)
    return (abs(r) < geometry.widths[lanes] / 2 + margin) & (-margin < s) & (s < geometry.lengths[lanes] + margin)


def followers(geometry):
    """Which roads lead from where others lead to, (n, n)."""
    starts, ends = (np.array([name[k] for name in geometry.names]) for k in (0, 1))
    return (ends[:, None] == starts) | (starts[:, None] == ends)


@EACH
def test_if_one_lane_conflicts_with_another_so_does_that_with_it(env_id):
    geometry = read(env_id)[1]
    zones = geometry.conflict_zones()
    seen = {(z.lane, z.other, z.kind, z.interval, z.other_interval) for z in zones}
    assert len(seen) == len(zones)
    assert seen == {(z.other, z.lane, z.kind, z.other_interval, z.interval) for z in zones}


@EACH
def test_where_lanes_of_different_roads_overlap_there_is_a_zone(env_id):
    """Any place on two of them that do not follow one another is in one, but for 5 cm at its edges."""
    geometry, rng = read(env_id)[1], np.random.default_rng(0)
    every, follow, intervals = numbers(geometry), followers(geometry), {}
    for zone in geometry.conflict_zones():
        intervals.setdefault(zone[:2], []).append(zone.interval)
    for lane in every:
        s = rng.uniform(0, geometry.lengths[lane], 150)
        r = rng.uniform(-0.5, 0.5, 150) * geometry.widths[lane]
        s, x, y = s[:, None], *(each[:, None] for each in geometry.position(lane, s, r))
        both = inside(geometry, every, x, y, -0.05) & (abs(r[:, None]) < geometry.widths[lane] / 2 - 0.05)
        both &= (s > 0.05) & (s < geometry.lengths[lane] - 0.05)
        roads = np.array([name[:2] == geometry.names[lane][:2] for name in geometry.names])
        for k, other in zip(*np.nonzero(both & ~roads & ~follow[lane]), strict=True):
            near = [first - 0.1 <= s[k, 0] <= last + 0.1 for first, last in intervals.get((lane, other), ())]
            assert any(near), (geometry.names[lane], geometry.names[other])


@EACH
def test_from_one_end_of_a_zone_to_the_other_the_lanes_overlap(env_id):
    geometry = read(env_id)[1]
    for z in geometry.conflict_zones():
        assert geometry.names[z.lane][:2] != geometry.names[z.other][:2]
        assert 0.0 <= z.interval[0] < z.interval[1] <= geometry.lengths[z.lane]
        s, half = np.linspace(*z.interval, 7)[:, None], geometry.widths[z.lane] / 2
        x, y = geometry.position(z.lane, s, np.linspace(-half, half, 81))
        assert inside(geometry, z.other, x, y, 0.1).any(axis=1).all()
        for lane in z[:2]:
            assert inside(geometry, lane, *z.outline.T, 0.01).all()


@EACH
def test_lanes_side_by_side_and_one_behind_the_other_do_not_conflict(env_id):
    assert not env_id.startswith(APART) or not read(env_id)[1].conflict_zones()


@settings(max_examples=30, deadline=None)
@given(radius=st.floats(5, 60), start=st.floats(-3, 3), turned=st.floats(0.3, 3), clockwise=st.booleans())
def test_arcs_side_by_side_do_not_conflict(radius, start, turned, clockwise):
    road, back = RoadNetwork(), start + turned
    road.add_lane("a", "b", CircularLane([0.0, 0.0], radius, start, back))
    phases = (start, back) if clockwise else (back, start)
    road.add_lane("c", "d", CircularLane([0.0, 0.0], radius + 4.0, *phases, clockwise=clockwise))
    assert not RoadGeometry.of(road).conflict_zones()


def meetings(env_id, lane):
    """What meets a lane, by name, and how."""
    geometry = read(env_id)[1]
    return {geometry.names[z.other][:2]: z.kind for z in geometry.conflict_zones() if geometry.names[z.lane] == lane}


@pytest.mark.parametrize("env_id", ["intersection-v0", "intersection-v2"])
def test_ways_of_an_intersection_cross_join_and_part(env_id):
    assert meetings(env_id, ("ir0", "il2", 0)) == {
        ("ir0", "il1"): Meeting.PART,
        ("ir0", "il3"): Meeting.PART,
        ("ir1", "il2"): Meeting.JOIN,
        ("ir3", "il2"): Meeting.JOIN,
        ("ir1", "il3"): Meeting.CROSS,
        ("ir3", "il1"): Meeting.CROSS,
        ("ir2", "il3"): Meeting.CROSS,
        ("ir3", "il0"): Meeting.CROSS,
    }


def test_two_straight_ways_cross_in_a_square():
    geometry = read("intersection-v0")[1]
    lane, other = (geometry.number(name) for name in (("ir0", "il2", 0), ("ir1", "il3", 0)))
    (zone,) = (z for z in geometry.conflict_zones() if z[:2] == (lane, other))
    assert np.allclose(np.diff(zone.interval), 4.0, atol=0.05)
    assert np.allclose(np.diff(zone.other_interval), 4.0, atol=0.05)
    assert np.allclose(zone.outline[:, 0].max() - zone.outline[:, 0].min(), 4.0, atol=0.05)


@pytest.mark.parametrize("env_id", ["roundabout-v0", "roundabout-generic-v1"])
def test_ways_of_a_roundabout_join_and_part(env_id):
    found = meetings(env_id, ("sx", "se", 1))
    assert found == {("ses", "se"): Meeting.JOIN, ("sx", "sxs"): Meeting.PART}
    assert not meetings(env_id, ("sx", "se", 0))


def test_the_lanes_of_a_merge_that_overlap_join():
    found = meetings(COMPLEX, ("merge-1.along", "merge-1.joint", 0))
    assert found == {("merge-1.taper", "merge-1.joint"): Meeting.JOIN}


def test_who_comes_the_other_way_in_the_same_lane_is_oncoming():
    geometry = read("two-way-v0")[1]
    assert meetings("two-way-v0", ("b", "a", 0)) == {("a", "b"): Meeting.ONCOMING}
    assert not meetings("two-way-v0", ("a", "b", 1))
    zone = geometry.conflict_zones()[0]
    assert np.allclose((zone.interval, zone.other_interval), (0.0, geometry.lengths[0]))


def test_lanes_that_meet_twice_have_two_zones():
    road = RoadNetwork()
    road.add_lane("a", "b", StraightLane([0.0, 5.0], [60.0, 5.0]))
    road.add_lane("c", "d", CircularLane([30.0, 0.0], 20.0, 0.0, np.pi, clockwise=True))
    zones = [z for z in RoadGeometry.of(road).conflict_zones() if z.lane == 0]
    assert [z.kind for z in zones] == [Meeting.CROSS] * 2
    (first, second), (third, fourth) = (z.interval for z in zones)
    assert np.allclose((first + fourth, second + third), 60.0, atol=0.1)


def test_an_arc_of_more_than_half_a_circle_has_its_zone_where_it_ends():
    road = RoadNetwork()
    arc = CircularLane([0.0, 0.0], 20.0, 0.0, 1.5 * np.pi, clockwise=True)
    road.add_lane("a", "b", arc)
    road.add_lane("c", "d", StraightLane([-8.0, -30.0], [-8.0, -5.0]))
    zones = [z for z in RoadGeometry.of(road).conflict_zones() if z.lane == 0]
    assert len(zones) == 1
    assert all(0.85 * arc.length < s < 0.97 * arc.length for s in zones[0].interval)


# -- what is handed in -----------------------------------------------------------------------------------


def test_shapes_broadcast():
    geometry = read("roundabout-v0")[1]
    s, r = geometry.project(np.arange(3)[:, None], np.zeros(4), 1.0)
    assert s.shape == r.shape == (3, 4)
    x, _ = geometry.position(2, 1.0)
    assert x.shape == geometry.heading(2, 1.0).shape == geometry.closest(0.0, 0.0, 0.0).s.shape == ()
    assert geometry.position(np.array([], int), [])[0].shape == (0,)


def test_what_cannot_be_read_is_refused():
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
    page = (Path(__file__).parents[2] / "docs" / "roads.md").read_text(encoding="utf-8")
    (block,) = (each for each in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "RoadGeometry" in each)
    names = {}
    exec(compile(block, "roads.md", "exec"), names)
    assert names["zones"]
    assert all(first.lane <= second.lane for first, second in pairwise(names["zones"]))
