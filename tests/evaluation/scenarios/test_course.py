"""The course of ComplexRoads-v0: its roads, their joints, and the right of way."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from highway_env.road.lane import AbstractLane, CircularLane, SineLane, StraightLane
from highway_env.road.regulation import RegulatedRoad
from highway_env.road.road import RoadNetwork
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from dynamics.highway_simulator.arithmetic import sums_of_numpy
from dynamics.highway_simulator.loops import addresses
from dynamics.road_networks.geometry.lanes import NetworkLanes, closest
from dynamics.road_networks.geometry.network import index_of, network_of
from dynamics.road_networks.traffic.priority_road import PriorityRoad
from dynamics.state import wrap_to_pi
from evaluation.report.course_picture import draw_map
from evaluation.scenarios import ComplexRoadsEnv
from evaluation.scenarios.course import SUBMAPS, ScenarioMap, build_map, order_of
from evaluation.scenarios.traffic import free_places
from shield.errors import ConfigError

COUNTS = st.fixed_dictionaries({kind: st.integers(0, 3) for kind in SUBMAPS}).filter(lambda c: any(c.values()))


def successors(network: RoadNetwork) -> Iterator[tuple[AbstractLane, AbstractLane]]:
    """Each lane, and the lane of the same number of each road that follows."""
    for ends in network.graph.values():
        for end, lanes in ends.items():
            for following in network.graph.get(end, {}).values():
                yield from zip(lanes, following, strict=True)


# -- the roads -------------------------------------------------------------------------------------------


@given(COUNTS)
def test_every_lane_continues_in_the_same_lane_of_each_following_road(counts: dict[str, int]) -> None:
    joints = 0
    for lane, following in successors(build_map(counts).network):
        joints += 1
        assert np.abs(lane.position(lane.length, 0.0) - following.position(0.0, 0.0)).max() < 1e-6
        assert abs(wrap_to_pi(lane.heading_at(lane.length) - following.heading_at(0.0))) < 1e-6
    assert joints >= 20


@settings(max_examples=40)
@given(COUNTS)
def test_every_exit_is_reached_from_every_spawn(counts: dict[str, int]) -> None:
    course = build_map(counts)
    crossings = 2 * counts["intersection"] + 2 * counts["roundabout"]
    assert len(course.exits) == 2 + crossings
    assert len(course.spawns) == 2 + crossings + counts["merge"]
    for start, _ in course.spawns:
        for name, (_, end) in course.exits.items():
            assert end == name
            assert course.network.shortest_path(start, name)


@given(COUNTS)
def test_the_course_has_the_configured_number_of_pieces(counts: dict[str, int]) -> None:
    kinds = order_of(counts)
    assert {kind: kinds.count(kind) for kind in SUBMAPS} == counts
    assert [piece.name.rpartition("-")[0] for piece in build_map(counts).pieces] == list(kinds)


@settings(max_examples=15)
@given(COUNTS)
def test_pieces_lie_apart_but_where_they_join(counts: dict[str, int]) -> None:
    clouds = []
    for piece in build_map(counts).pieces:
        lanes = [lane for edge in piece.edges for lane in edge.lanes]
        # Without their ends, which neighbours share.
        along = [(lane, s) for lane in lanes for s in np.linspace(0.0, lane.length, 9) if 3 < s < lane.length - 3]
        clouds.append(np.array([lane.position(s, 0.0) for lane, s in along]))
    for one, other in combinations(clouds, 2):
        gaps = np.hypot(*(one[:, None] - other[None]).transpose(2, 0, 1))
        assert gaps.min() > AbstractLane.DEFAULT_WIDTH


def test_the_default_course_is_that_of_the_paper() -> None:
    kinds = [piece.name.rpartition("-")[0] for piece in build_map().pieces]
    assert sorted(kinds) == sorted(["merge", "intersection", "roundabout"] * 2 + ["straight"] * 4)
    shapes = {type(lane) for lane in build_map().network.lanes_list()}
    assert shapes == {StraightLane, SineLane, CircularLane}


@pytest.mark.parametrize(
    ("counts", "told"),
    [
        ({"merge": -1}, "from 0 on"),
        ({"merge": 1.5}, "from 0 on"),
        ({"merge": True}, "from 0 on"),
        ({"bridge": 1}, "merge, intersection, roundabout, straight"),
        ({}, "at least one of merge"),
        ({"merge": 0}, "at least one of merge"),
        ([2, 2], "merge, intersection, roundabout, straight"),
    ],
)
def test_counts_that_make_no_course_are_refused(counts: Any, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        ComplexRoadsEnv({"submap_counts": counts})


PLACES = st.tuples(st.floats(-50, 850), st.floats(-100, 600), st.none() | st.floats(-4, 4))
COURSE = build_map()


@settings(max_examples=200)
@given(PLACES)
def test_the_nearest_lane_is_that_of_highway_env(place: tuple[float, float, float | None]) -> None:
    position, heading = np.array(place[:2]), place[2]
    network = COURSE.network
    assert network.get_closest_lane_index(position, heading) == RoadNetwork.get_closest_lane_index(
        network, position, heading
    )


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 10**6), st.floats(-6, 6), st.floats(-5, 5), st.floats(-4, 4), st.integers(0, 10**6))
def test_a_body_is_looked_for_among_the_lanes_near_its_own(
    lane: int, beyond: float, across: float, turned: float, guess: int
) -> None:
    names, network = list(index_of(COURSE.network)), network_of(COURSE.network)
    number = lane % len(names)
    near = network.near[number][network.near[number] >= 0]
    assert number in near
    assert len(near) < len(names) / 4
    at = COURSE.network.get_lane(names[number])
    s = beyond if guess % 2 else at.length + beyond
    position, heading = at.position(s, across), float(at.heading_at(s)) + turned
    lanes = NetworkLanes(sums_of_numpy()[0], addresses(), network.lanes, network.ids, network.near)
    found, *place = closest(lanes, *position.tolist(), heading, int(near[guess % len(near)]))
    assert names[found] == RoadNetwork.get_closest_lane_index(COURSE.network, position, heading)
    assert tuple(place) == pytest.approx(COURSE.network.get_lane(names[found]).local_coordinates(position), abs=1e-9)


# -- rights of way ---------------------------------------------------------------------------------------


@settings(max_examples=25)
@given(st.integers(0, 10_000), st.floats(0, 12))
def test_conflicts_are_those_that_highway_env_finds(seed: int, speed: float) -> None:
    rng = np.random.default_rng(seed)
    env = SHARED
    places = free_places(env.course)
    (one, s), (other, t) = (places[i] for i in rng.choice(len(places), 2, replace=False))
    first = Vehicle.make_on_lane(env.road, one, s, speed)
    # Near each other as a rule, so that there are conflicts among them.
    second = Vehicle(env.road, first.position + rng.normal(0, 8, 2), first.heading + rng.normal(), speed)
    far = Vehicle.make_on_lane(env.road, other, t, speed)
    for a, b in combinations((first, second, far), 2):
        assert PriorityRoad.is_conflict_possible(a, b) == bool(RegulatedRoad.is_conflict_possible(a, b))


SHARED = ComplexRoadsEnv({"vehicle_density": 0})
SHARED.reset(seed=0)


def test_a_follower_yields_for_any_priorities() -> None:
    road = SHARED.road
    ((stop, end),) = [(a, b) for a, b in SHARED.course.exits.values() if b == "intersection-2.right.out"]
    inside = next(a for a in road.network.graph if stop in road.network.graph[a] and "back" in a)
    behind = Vehicle.make_on_lane(road, (inside, stop, 0), 5.0, 8.0)
    ahead = Vehicle.make_on_lane(road, (stop, end, 0), 2.0, 1.0)
    assert PriorityRoad.respect_priorities(ahead, behind) is behind
    assert PriorityRoad.respect_priorities(behind, ahead) is behind


def test_left_turns_yield_to_oncoming_vehicles() -> None:
    graph = SHARED.road.network.graph
    turns = {end: lanes[0] for end, lanes in graph["intersection-1.back.stop"].items()}
    left, ahead = turns["intersection-1.left.begin"], turns["intersection-1.front.begin"]
    assert left.priority < ahead.priority
    assert graph["intersection-1.left.stop"]["intersection-1.right.begin"][0].priority < left.priority


def test_the_whole_course_is_pictured(tmp_path: Path) -> None:
    path = draw_map(tmp_path / "new" / "course.png", width=400)
    picture = np.asarray(Image.open(path).convert("RGB"))
    assert picture.shape[1] == 400
    assert (picture == (50, 200, 0)).all(axis=2).any()  # the ego's dot
    bright = (picture.min(axis=2) > 150).any(axis=0)
    assert bright[:20].any()
    assert bright[-20:].any()
    with pytest.raises(ConfigError, match=r"\.png"):
        draw_map(tmp_path / "course.gif")


def test_a_course_is_the_same_each_time() -> None:
    one, other = (build_map({"merge": 1, "intersection": 2}) for _ in range(2))
    assert isinstance(one, ScenarioMap)
    assert one.network.to_config() == other.network.to_config()
    assert (one.spawns, dict(one.exits)) == (other.spawns, dict(other.exits))
