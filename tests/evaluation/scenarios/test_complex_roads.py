"""ComplexRoads-v0: observations, rewards and ends; the traffic stays on its roads, and a scripted ego arrives."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from gymnasium.utils.env_checker import check_env
from network_pair import Pair
from stable_baselines3.common.env_checker import check_env as check_env_of_sb3
from typer.testing import CliRunner

from evaluation.commands.cli import app
from evaluation.running.named_policies import make_policy
from evaluation.scenarios import ComplexRoadsEnv
from evaluation.scenarios.traffic import ENTRY, begin_on, recycle
from evaluation.wrappers.signed_lane import lane_offset
from shield import Shield, ShieldConfig
from shield.errors import ConfigError

META = {"type": "DiscreteMetaAction", "target_speeds": [0, 4, 8, 12]}
IDLE = 1


def make(seed: int = 0, **config: Any) -> Any:
    env = ComplexRoadsEnv(config)
    env.reset(seed=seed)
    return env


# -- the environment -------------------------------------------------------------------------------------


def test_the_environment_is_registered_and_passes_the_checks_of_gymnasium_and_sb3() -> None:
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
def test_invalid_configurations_are_refused(config: dict[str, Any], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        ComplexRoadsEnv(config)


def test_the_observation_ends_in_the_signed_numbers_unless_switched_off() -> None:
    env, bare = make(4), make(4, use_signed_lane_obs=False)
    env.vehicle.position += [0.0, 0.75]
    env.vehicle.heading += 0.25
    bare.vehicle.position, bare.vehicle.heading = env.vehicle.position, env.vehicle.heading
    seen, plain = env.observation_type.observe(), bare.observation_type.observe()
    assert bare.observation_space.shape == (10, 7)
    assert seen[-2:] == pytest.approx([0.75, 0.25])
    assert np.array_equal(seen[:-2], plain.ravel())


def test_the_configured_number_of_vehicles_is_spawned_without_contact() -> None:
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


def test_the_time_limit_ends_an_episode_and_the_road_edge_only_if_configured() -> None:
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


def test_vehicles_that_left_and_wrecks_enter_again_and_others_do_not() -> None:
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


def test_another_exit_is_no_arrival() -> None:
    env = make(action=META, vehicle_density=0, destination="west.out")
    end = env.course.exits["roundabout-1.left.out"]
    begin_on(env.vehicle, (*end, 0), 40.0, end[1])
    _, _, terminated, _, info = env.step(IDLE)
    assert not terminated
    assert not info["success"]


def test_the_command_line_drives_the_environment(tmp_path: Path) -> None:
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
    """Frame by frame, bit for bit, including yielding vehicles."""
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


def test_the_shield_predicts_the_traffic():
    """With simulated traffic no vehicle moves otherwise than predicted, and no contact occurs."""
    env = gym.make("evaluation.scenarios:ComplexRoads-v0", config={**SIMULATED, "duration": 12})
    observation, _ = env.reset(seed=3)
    shield, done = Shield(lambda obs: 3, env, ShieldConfig.simulated_traffic(), frames=False), False
    while not done:
        observation, _, terminated, truncated, _ = env.step(int(shield.predict(observation)[0]))
        done = terminated or truncated
    assert shield._filters[0].violations == 0
    assert not env.unwrapped.vehicle.crashed
