"""Conflict zones of the lanes of a road network, and their kinds."""

from __future__ import annotations

import numpy as np
import pytest
from highway_env.road.lane import CircularLane, StraightLane
from highway_env.road.road import RoadNetwork
from hypothesis import given, settings
from hypothesis import strategies as st
from road_geometries import COMPLEX, EACH, numbers, read

from dynamics.road_networks.geometry.conflict_zones import Meeting, conflict_zones
from dynamics.road_networks.geometry.road_geometry import RoadGeometry

APART = ("highway-", "merge-", "exit-", "u-turn-", "racetrack-", "parking-", "lane-keeping-")
"""Roads of which no lanes overlap: those of highway-env's merges run beside each other until one ends."""


def inside(geometry, lanes, x, y, margin):
    """Whether places are on the lanes, or no further out than the margin [m]."""
    s, r = geometry.project(lanes, x, y)
    return (abs(r) < geometry.widths[lanes] / 2 + margin) & (-margin < s) & (s < geometry.lengths[lanes] + margin)


def followers(geometry):
    """Which roads lead from where others lead to, (n, n)."""
    starts, ends = (np.array([name[k] for name in geometry.names]) for k in (0, 1))
    return (ends[:, None] == starts) | (starts[:, None] == ends)


@EACH
def test_conflicts_of_lanes_are_symmetric(env_id):
    geometry = read(env_id)[1]
    zones = conflict_zones(geometry)
    seen = {(z.lane, z.other, z.kind, z.interval, z.other_interval) for z in zones}
    assert len(seen) == len(zones)
    assert seen == {(z.other, z.lane, z.kind, z.other_interval, z.interval) for z in zones}


@EACH
def test_an_overlap_of_lanes_of_different_roads_is_a_zone(env_id):
    """Any place on two lanes that do not follow one another is inside a zone, up to 5 cm at its edges."""
    geometry, rng = read(env_id)[1], np.random.default_rng(0)
    every, follow, intervals = numbers(geometry), followers(geometry), {}
    for zone in conflict_zones(geometry):
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
def test_the_lanes_overlap_along_a_whole_zone(env_id):
    geometry = read(env_id)[1]
    for z in conflict_zones(geometry):
        assert geometry.names[z.lane][:2] != geometry.names[z.other][:2]
        assert 0.0 <= z.interval[0] < z.interval[1] <= geometry.lengths[z.lane]
        s, half = np.linspace(*z.interval, 7)[:, None], geometry.widths[z.lane] / 2
        x, y = geometry.position(z.lane, s, np.linspace(-half, half, 81))
        assert inside(geometry, z.other, x, y, 0.1).any(axis=1).all()
        for lane in z[:2]:
            assert inside(geometry, lane, *z.outline.T, 0.01).all()


@EACH
def test_parallel_and_successive_lanes_do_not_conflict(env_id):
    assert not env_id.startswith(APART) or not conflict_zones(read(env_id)[1])


@settings(max_examples=30, deadline=None)
@given(radius=st.floats(5, 60), start=st.floats(-3, 3), turned=st.floats(0.3, 3), clockwise=st.booleans())
def test_arcs_side_by_side_do_not_conflict(radius, start, turned, clockwise):
    road, back = RoadNetwork(), start + turned
    road.add_lane("a", "b", CircularLane([0.0, 0.0], radius, start, back))
    phases = (start, back) if clockwise else (back, start)
    road.add_lane("c", "d", CircularLane([0.0, 0.0], radius + 4.0, *phases, clockwise=clockwise))
    assert not conflict_zones(RoadGeometry.of(road))


def meetings(env_id, lane):
    """The lanes that conflict with a lane, by name, and the kinds of the conflicts."""
    geometry = read(env_id)[1]
    return {geometry.names[z.other][:2]: z.kind for z in conflict_zones(geometry) if geometry.names[z.lane] == lane}


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
    (zone,) = (z for z in conflict_zones(geometry) if z[:2] == (lane, other))
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


def test_opposite_lanes_in_the_same_place_are_oncoming():
    geometry = read("two-way-v0")[1]
    assert meetings("two-way-v0", ("b", "a", 0)) == {("a", "b"): Meeting.ONCOMING}
    assert not meetings("two-way-v0", ("a", "b", 1))
    zone = conflict_zones(geometry)[0]
    assert np.allclose((zone.interval, zone.other_interval), (0.0, geometry.lengths[0]))


def test_lanes_that_meet_twice_have_two_zones():
    road = RoadNetwork()
    road.add_lane("a", "b", StraightLane([0.0, 5.0], [60.0, 5.0]))
    road.add_lane("c", "d", CircularLane([30.0, 0.0], 20.0, 0.0, np.pi, clockwise=True))
    zones = [z for z in conflict_zones(RoadGeometry.of(road)) if z.lane == 0]
    assert [z.kind for z in zones] == [Meeting.CROSS] * 2
    (first, second), (third, fourth) = (z.interval for z in zones)
    assert np.allclose((first + fourth, second + third), 60.0, atol=0.1)


def test_an_arc_of_more_than_half_a_circle_has_its_zone_where_it_ends():
    road = RoadNetwork()
    arc = CircularLane([0.0, 0.0], 20.0, 0.0, 1.5 * np.pi, clockwise=True)
    road.add_lane("a", "b", arc)
    road.add_lane("c", "d", StraightLane([-8.0, -30.0], [-8.0, -5.0]))
    zones = [z for z in conflict_zones(RoadGeometry.of(road)) if z.lane == 0]
    assert len(zones) == 1
    assert all(0.85 * arc.length < s < 0.97 * arc.length for s in zones[0].interval)
