"""ComplexRoads-v0: the roads join and lead everywhere, the traffic stays on them, and a scripted ego arrives."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from gymnasium.utils.env_checker import check_env
from highway_env.road.lane import AbstractLane, CircularLane, SineLane, StraightLane
from highway_env.road.regulation import RegulatedRoad
from highway_env.road.road import RoadNetwork
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import given, settings
from hypothesis import strategies as st
from network_pair import Pair
from PIL import Image
from stable_baselines3.common.env_checker import check_env as check_env_of_sb3
from typer.testing import CliRunner

from dynamics.networks.priority_road import PriorityRoad
from dynamics.state import wrap_to_pi
from evaluation.commands.cli import app
from evaluation.report.course_picture import draw_course
from evaluation.running.named_policies import make_policy
from evaluation.scenarios import ComplexRoadsEnv
from evaluation.scenarios.course import SUBMAPS, Course, build_course, order_of
from evaluation.scenarios.traffic import ENTRY, begin_on, free_places, recycle
from evaluation.wrappers.signed_lane import lane_offset
from shield import Shield, ShieldConfig
from shield.errors import ConfigError

META = {"type": "DiscreteMetaAction", "target_speeds": [0, 4, 8, 12]}
IDLE = 1
COUNTS = st.fixed_dictionaries({kind: st.integers(0, 3) for kind in SUBMAPS}).filter(lambda c: any(c.values()))


def make(seed: int = 0, **config: Any) -> Any:
    env = ComplexRoadsEnv(config)
    env.reset(seed=seed)
    return env


def successors(network: RoadNetwork) -> Iterator[tuple[AbstractLane, AbstractLane]]:
    """Each lane, and the lane of the same number of each road that follows."""
    for ends in network.graph.values():
        for end, lanes in ends.items():
            for following in network.graph.get(end, {}).values():
                yield from zip(lanes, following, strict=True)


# -- the roads -------------------------------------------------------------------------------------------


@given(COUNTS)
def test_every_lane_goes_over_into_the_same_lane_of_every_road_that_follows(counts: dict[str, int]) -> None:
    joints = 0
    for lane, following in successors(build_course(counts).network):
        joints += 1
        assert np.abs(lane.position(lane.length, 0.0) - following.position(0.0, 0.0)).max() < 1e-6
        assert abs(wrap_to_pi(lane.heading_at(lane.length) - following.heading_at(0.0))) < 1e-6
    assert joints >= 20


@settings(max_examples=40)
@given(COUNTS)
def test_every_exit_is_reached_from_every_spawn(counts: dict[str, int]) -> None:
    course = build_course(counts)
    crossings = 2 * counts["intersection"] + 2 * counts["roundabout"]
    assert len(course.exits) == 2 + crossings
    assert len(course.spawns) == 2 + crossings + counts["merge"]
    for start, _ in course.spawns:
        for name, (_, end) in course.exits.items():
            assert end == name
            assert course.network.shortest_path(start, name)


@given(COUNTS)
def test_there_are_as_many_pieces_as_were_asked_for(counts: dict[str, int]) -> None:
    kinds = order_of(counts)
    assert {kind: kinds.count(kind) for kind in SUBMAPS} == counts
    assert [piece.name.rpartition("-")[0] for piece in build_course(counts).pieces] == list(kinds)


@settings(max_examples=15)
@given(COUNTS)
def test_pieces_lie_apart_but_where_they_join(counts: dict[str, int]) -> None:
    clouds = []
    for piece in build_course(counts).pieces:
        lanes = [lane for edge in piece.edges for lane in edge.lanes]
        # Without their ends, which neighbours share.
        along = [(lane, s) for lane in lanes for s in np.linspace(0.0, lane.length, 9) if 3 < s < lane.length - 3]
        clouds.append(np.array([lane.position(s, 0.0) for lane, s in along]))
    for one, other in combinations(clouds, 2):
        gaps = np.hypot(*(one[:, None] - other[None]).transpose(2, 0, 1))
        assert gaps.min() > AbstractLane.DEFAULT_WIDTH


def test_the_default_course_is_that_of_the_paper() -> None:
    kinds = [piece.name.rpartition("-")[0] for piece in build_course().pieces]
    assert sorted(kinds) == sorted(["merge", "intersection", "roundabout"] * 2 + ["straight"] * 4)
    shapes = {type(lane) for lane in build_course().network.lanes_list()}
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
COURSE = build_course()


@settings(max_examples=200)
@given(PLACES)
def test_the_nearest_lane_is_the_one_that_highway_env_finds(place: tuple[float, float, float | None]) -> None:
    position, heading = np.array(place[:2]), place[2]
    network = COURSE.network
    assert network.get_closest_lane_index(position, heading) == RoadNetwork.get_closest_lane_index(
        network, position, heading
    )


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


SHARED = make(vehicle_density=0)


def test_who_follows_yields_whatever_the_priorities() -> None:
    road = SHARED.road
    ((stop, end),) = [(a, b) for a, b in SHARED.course.exits.values() if b == "intersection-2.right.out"]
    inside = next(a for a in road.network.graph if stop in road.network.graph[a] and "back" in a)
    behind = Vehicle.make_on_lane(road, (inside, stop, 0), 5.0, 8.0)
    ahead = Vehicle.make_on_lane(road, (stop, end, 0), 2.0, 1.0)
    assert PriorityRoad.respect_priorities(ahead, behind) is behind
    assert PriorityRoad.respect_priorities(behind, ahead) is behind


def test_left_turns_yield_to_who_comes_straight_on_from_ahead() -> None:
    graph = SHARED.road.network.graph
    turns = {end: lanes[0] for end, lanes in graph["intersection-1.back.stop"].items()}
    left, ahead = turns["intersection-1.left.begin"], turns["intersection-1.front.begin"]
    assert left.priority < ahead.priority
    assert graph["intersection-1.left.stop"]["intersection-1.right.begin"][0].priority < left.priority


# -- the environment -------------------------------------------------------------------------------------


def test_it_is_registered_and_passes_the_checks_of_gymnasium_and_sb3() -> None:
    env = gym.make("evaluation.scenarios:ComplexRoads-v0", config={"vehicle_density": 3}, render_mode="rgb_array")
    assert env.action_space.n == 45
    check_env(env.unwrapped)
    check_env_of_sb3(env.unwrapped)
    env.close()


@pytest.mark.parametrize(
    "action", [None, {"type": "DiscreteAction"}, {"type": "ContinuousAction"}, META], ids=lambda a: str(a and a["type"])
)
def test_equal_seeds_give_equal_episodes_and_others_do_not(action: Any) -> None:
    def drive(seed: int) -> list[Any]:
        env = make(seed, random_start=True, **({"action": action} if action else {}))
        env.action_space.seed(3)
        seen = []
        for _ in range(8):
            observation, reward, *_ = env.step(env.action_space.sample())
            seen.append((observation.tolist(), reward))
        return [env.destination, seen]

    assert drive(5) == drive(5)
    assert drive(5) != drive(6)


def test_a_copy_drives_as_the_environment_does() -> None:
    env = make(3)
    copied = copy.deepcopy(env)
    (seen, reward, *_), (seen_too, reward_too, *_) = (each.step(30) for each in (env, copied))
    assert np.array_equal(seen, seen_too)
    assert reward == reward_too
    assert copied.road.network is not env.road.network


def test_throttle_and_steering_are_on_a_grid_of_5_by_9() -> None:
    env = make(vehicle_density=0)
    asked = set()
    for action in range(45):
        env.action_type.act(action)
        asked.add((env.vehicle.action["acceleration"], env.vehicle.action["steering"]))
    accelerations, steerings = (sorted({pair[i] for pair in asked}) for i in (0, 1))
    assert len(asked) == 45
    assert accelerations == pytest.approx(np.linspace(-5, 5, 5))
    assert steerings == pytest.approx(np.linspace(-np.pi / 4, np.pi / 4, 9))
    idle = make_policy("idle", env).predict(None)[0]
    env.action_type.act(idle)
    assert env.vehicle.action == {"acceleration": 0.0, "steering": 0.0}


@pytest.mark.parametrize("counts", [[5], [5, 1], [5, 9, 2], [5, 2.5]])
def test_a_grid_of_no_two_numbers_is_refused(counts: Any) -> None:
    with pytest.raises(ConfigError, match="whole number"):
        ComplexRoadsEnv({"action": {"type": "DiscreteAction", "actions_per_axis": counts}})


@pytest.mark.parametrize(
    ("config", "told"),
    [
        ({"vehicles_density": 3}, "have .*vehicle_density"),
        ({"vehicle_density": -1}, "vehicle_density is a whole number"),
        ({"vehicle_density": 100_000}, "have room here"),
        ({"duration": 0}, "duration"),
        ({"random_start": 1}, "random_start is true or false"),
        ({"destination": "nowhere"}, "have west.out"),
        ({"on_lane_reward": {"crush": 1}}, "have crash"),
        ({"other_vehicles_type": "highway_env.vehicle.kinematics.Vehicle"}, "IDMVehicle"),
    ],
)
def test_configurations_that_cannot_be_are_refused(config: dict[str, Any], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        ComplexRoadsEnv(config)


def test_the_observation_ends_in_the_signed_numbers_unless_it_is_not_to() -> None:
    env, bare = make(4), make(4, use_signed_lane_obs=False)
    env.vehicle.position += [0.0, 0.75]
    env.vehicle.heading += 0.25
    bare.vehicle.position, bare.vehicle.heading = env.vehicle.position, env.vehicle.heading
    seen, plain = env.observation_type.observe(), bare.observation_type.observe()
    assert bare.observation_space.shape == (10, 7)
    assert seen[-2:] == pytest.approx([0.75, 0.25])
    assert np.array_equal(seen[:-2], plain.ravel())


def test_there_are_as_many_others_as_asked_for_and_none_touch() -> None:
    env = make(2, vehicle_density=40)
    assert len(env.road.vehicles) == 41
    places = np.array([vehicle.position for vehicle in env.road.vehicles])
    gaps = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1)) + 1e9 * np.eye(41)
    assert gaps.min() > 3.9  # a lane beside; along a lane it is 25 m
    assert not any(vehicle.crashed for vehicle in env.road.vehicles)
    assert all(vehicle.route[-1][1] in env.course.exits for vehicle in env.road.vehicles[1:])


def test_random_starts_are_on_roads_that_lead_in() -> None:
    env, starts = make(vehicle_density=0, random_start=True), set()
    for seed in range(30):
        env.reset(seed=seed)
        starts.add(env.vehicle.lane_index)
        assert env.vehicle.lane_index[:2] in env.course.spawns
        assert lane_offset(env.vehicle) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert len(starts) > 10
    env = make(vehicle_density=0)
    assert env.vehicle.lane_index[:2] == env.course.spawns[0]


def test_a_crash_costs_ten_and_ends_the_episode() -> None:
    env = make(vehicle_density=1)
    other = env.road.vehicles[1]
    begin_on(other, env.vehicle.lane_index, ENTRY + 3.0, env.destination)
    _, reward, terminated, _, info = env.step(22)
    assert (reward, terminated, info["success"], info["crashed"]) == (-10.0, True, False, True)


def test_the_reward_is_that_of_the_paper() -> None:
    env = make(vehicle_density=0)
    env.vehicle.position += [0.0, 1.5]
    env.vehicle.heading += 0.1
    _, reward, *_ = env.step(22)
    offset, speed = lane_offset(env.vehicle), env.vehicle.speed
    assert reward == pytest.approx(np.cos(offset.heading) * speed / max(1.0, abs(offset.distance)) / 20.0)
    assert offset.distance > 1.5


def test_time_ends_an_episode_and_the_edge_of_the_road_only_when_asked() -> None:
    for ends in (False, True):
        env = make(vehicle_density=0, duration=0.4, offroad_terminal=ends)
        env.vehicle.position += [0.0, 30.0]
        _, _, terminated, truncated, _ = env.step(22)
        assert (terminated, truncated) == (ends, False)
    assert env.step(22)[3]


# -- real episodes ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1])
def test_traffic_drives_30_seconds_without_leaving_the_road(seed: int) -> None:
    env = make(seed, vehicle_density=12)
    env.road.vehicles.remove(env.vehicle)
    begun = {id(vehicle): vehicle.position.copy() for vehicle in env.road.vehicles}
    way = dict.fromkeys(begun, 0.0)
    for frame in range(450):
        before = {id(vehicle): vehicle.position.copy() for vehicle in env.road.vehicles}
        env.road.act()
        env.road.step(1 / 15)
        for vehicle in env.road.vehicles:
            assert vehicle.on_road, (frame, vehicle.lane_index)
            way[id(vehicle)] += float(np.hypot(*(vehicle.position - before[id(vehicle)])))
        if frame % 3 == 0:
            recycle(env.road, env.course, None)
    assert len(env.road.vehicles) == 12
    assert np.median(list(way.values())) > 150.0


def test_who_has_left_and_who_is_wrecked_enters_again_and_others_do_not() -> None:
    env = make(vehicle_density=3)
    left, wreck, going = env.road.vehicles[1:]
    end = env.course.exits["roundabout-2.front.out"]
    begin_on(left, (*end, 0), 30.0, end[1])
    wreck.crashed, wreck.speed = True, 0.0
    was = going.position.copy()
    recycle(env.road, env.course, env.vehicle)
    for vehicle in (left, wreck):
        assert vehicle.lane_index[:2] in env.course.spawns
        assert vehicle.speed == vehicle.lane.speed_limit
        assert not vehicle.crashed
    assert np.array_equal(going.position, was)
    assert len({id(vehicle) for vehicle in env.road.vehicles}) == 4


PAIRS = [
    ("west.in", 0, "west.out"),
    ("merge-1.ramp.in", 1, "intersection-1.front.out"),
    ("intersection-1.left.in", 0, "roundabout-2.right.out"),
    ("roundabout-2.left.in", 1, "intersection-2.front.out"),
    ("merge-2.ramp.in", 0, "intersection-2.right.out"),
    ("intersection-2.right.in", 1, "roundabout-2.left.out"),
]


@pytest.mark.parametrize(("spawn", "lane", "destination"), PAIRS)
def test_an_ego_that_keeps_to_its_route_arrives(spawn: str, lane: int, destination: str) -> None:
    env = make(action=META, vehicle_density=0, destination=destination, policy_frequency=3)
    (start,) = [edge for edge in env.course.spawns if edge[0] == spawn]
    begin_on(env.vehicle, (*start, lane), ENTRY, destination)
    env.vehicle.target_speed = 8.0
    for _ in range(600):
        _, _, terminated, _, info = env.step(IDLE)
        assert env.vehicle.on_road
        assert abs(lane_offset(env.vehicle).distance) < 1.0
        if terminated:
            break
    assert info["success"]
    assert info["is_success"]
    assert env.vehicle.lane_index[1] == destination


def test_one_arrives_at_no_other_exit() -> None:
    env = make(action=META, vehicle_density=0, destination="west.out")
    end = env.course.exits["roundabout-1.left.out"]
    begin_on(env.vehicle, (*end, 0), 40.0, end[1])
    _, _, terminated, _, info = env.step(IDLE)
    assert not terminated
    assert not info["success"]


def test_the_whole_course_is_pictured(tmp_path: Path) -> None:
    path = draw_course(tmp_path / "new" / "course.png", width=400)
    picture = np.asarray(Image.open(path).convert("RGB"))
    assert picture.shape[1] == 400
    assert (picture == (50, 200, 0)).all(axis=2).any()  # the ego's dot
    bright = (picture.min(axis=2) > 150).any(axis=0)
    assert bright[:20].any()
    assert bright[-20:].any()
    with pytest.raises(ConfigError, match=r"\.png"):
        draw_course(tmp_path / "course.gif")


def test_a_course_is_the_same_each_time() -> None:
    one, other = (build_course({"merge": 1, "intersection": 2}) for _ in range(2))
    assert isinstance(one, Course)
    assert one.network.to_config() == other.network.to_config()
    assert (one.spawns, dict(one.exits)) == (other.spawns, dict(other.exits))


def test_the_command_line_drives_it(tmp_path: Path) -> None:
    config, output = tmp_path / "short.toml", tmp_path / "episodes.parquet"
    config.write_text("duration = 1\nvehicle_density = 1\n", encoding="utf-8")
    asked = ["--env-id", "evaluation.scenarios:ComplexRoads-v0", "--env-config", str(config), "--shield", "none"]
    result = CliRunner().invoke(app, ["evaluate", *asked, "--episodes", "2", "--jobs", "1", "--output", str(output)])
    assert result.exit_code == 0, result.output
    table = pd.read_parquet(output)
    assert table["policy"].tolist() == ["random", "random"]
    assert table["steps"].tolist() == [5, 5]
    assert table["success"].tolist() == [False, False]


SIMULATED = {"action": {"type": "DiscreteMetaAction", "target_speeds": [0, 5, 10, 15]}, "policy_frequency": 1}


def test_the_compiled_traffic_is_the_same():
    """Frame by frame, bit for bit, who yields included."""
    pair = Pair("ComplexRoads-v0", 1, {**SIMULATED, "random_start": True, "vehicle_density": 25})
    rng, yielded = np.random.default_rng(1), 0
    for k in range(14):
        action = int(rng.integers(5))
        pair.env._simulate(action)
        pair.compare(pair.simulator.step(action)[-1])
        yielded += sum(getattr(v, "is_yielding", False) for v in pair.env.road.vehicles)
        if k % 7 == 6:
            recycle(pair.env.road, pair.env.course, pair.env.vehicle)
            pair.start()
    assert yielded


def test_the_shield_foretells_it():
    """Behind verification by simulation nobody does anything else than was foretold, and nobody touches."""
    env = gym.make("evaluation.scenarios:ComplexRoads-v0", config={**SIMULATED, "duration": 12})
    observation, _ = env.reset(seed=3)
    shield, done = Shield(lambda obs: 3, env, ShieldConfig.exact(), frames=False), False
    while not done:
        observation, _, terminated, truncated, _ = env.step(int(shield.predict(observation)[0]))
        done = terminated or truncated
    assert shield._doors[0].violations == 0
    assert not env.unwrapped.vehicle.crashed
