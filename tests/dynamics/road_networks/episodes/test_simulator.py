"""The compiled episodes on road networks equal highway-env's, bit for bit: observations, rewards, ends, infos,
states and random numbers, in whole episodes from their seeds."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from road_pair import RoadPair

from dynamics.compiled import compiled
from dynamics.errors import ActionError, ConfigError, SceneError
from dynamics.highway_simulator.random import from_generator
from dynamics.road_networks.episodes.draws import normal, two_of
from dynamics.road_networks.episodes.simulator import RoadSimulator
from dynamics.road_networks.episodes.vector_env import RoadVectorEnv

ROADS = (
    *("merge-v0", "merge-v1", "merge-generic-v0", "merge-generic-v1", "roundabout-v0", "roundabout-v1"),
    *("roundabout-generic-v0", "roundabout-generic-v1", "exit-v0", "exit-v1", "two-way-v0", "u-turn-v0", "u-turn-v1"),
    *("intersection-v0", "intersection-v1", "intersection-v2"),
)
LINEAR = tuple(f"highway_env.vehicle.behavior.{name}Vehicle" for name in ("Linear", "Aggressive", "Defensive"))
FEATURES = (
    *("presence", "x", "y", "vx", "vy", "heading", "cos_h", "sin_h", "cos_d", "sin_d"),
    *("long_off", "lat_off", "ang_off"),
)
CONFIGS = {
    "merge-v1": {"lane_change_reward": -0.3, "reward_speed_range": [15, 33], "simulation_frequency": 10},
    "merge-generic-v1": {"lanes_count": 3, "vehicles_count": 9, "parallel_merge_length": 60},
    "roundabout-v0": {
        "duration": 60,
        "policy_frequency": 15,
        "action": {"type": "DiscreteMetaAction", "target_speeds": [20, 25, 30]},
        "other_vehicles_type": "highway_env.vehicle.behavior.AggressiveVehicle",
        "reward_speed_range": [20, 20],
        "normalize_reward": False,
    },
    "roundabout-v1": {"incoming_vehicle_destination": 1, "normalize_reward": False, "right_lane_reward": 0.3},
    "roundabout-generic-v0": {"roundabout_lanes": 3, "roundabout_radius": 30, "vehicles_count": 9, "duration": 4},
    "exit-v1": {"lanes_count": 3, "vehicles_count": 8, "normalize_reward": False, "policy_frequency": 2},
    "u-turn-v0": {"observation": {"type": "Kinematics", "features": ["x", "ang_off"], "order": "shuffled"}},
    "two-way-v0": {"observation": {"type": "TimeToCollision", "horizon": 8}, "policy_frequency": 2},
    "intersection-v0": {"destination": None, "spawn_probability": 0.9, "normalize_reward": True},
    "intersection-v2": {"initial_vehicle_count": 3, "offroad_terminal": True, "duration": 5, "policy_frequency": 3},
}


@compiled
def _normals(row, out):
    for k in range(len(out)):
        out[k] = normal(row)


@compiled
def _pairs(row, n, out):
    for k in range(len(out)):
        out[k, 0], out[k, 1] = two_of(row, n)


@given(st.integers(0, 2**63 - 1), st.integers(3, 9))
@settings(max_examples=20, deadline=None)
def test_random_draws_are_those_of_numpy(seed, n):
    generator = np.random.default_rng(seed)
    row, normals, pairs = from_generator(generator), np.zeros(4_000), np.zeros((50, 2), np.int64)
    _normals(row, normals)
    _pairs(row, n, pairs)
    assert np.array_equal(normals, generator.normal(size=len(normals)))
    assert pairs.tolist() == [generator.choice(range(n), size=2, replace=False).tolist() for _ in pairs]
    assert np.array_equal(from_generator(generator), row)


@pytest.mark.parametrize("env_id", ROADS[1::2])
def test_an_episode_is_the_same(env_id):
    RoadPair(env_id).drive([31], decisions=10)


@pytest.mark.parametrize("env_id", sorted(CONFIGS)[::2])
def test_an_episode_of_another_configuration_is_the_same(env_id):
    RoadPair(env_id, CONFIGS[env_id]).drive([7], decisions=8)


@pytest.mark.parametrize(("env_id", "kind"), zip(ROADS[::2], LINEAR * 3, strict=False))
def test_an_episode_among_vehicles_of_the_linear_model_is_the_same(env_id, kind):
    """Their parameters are drawn one by one, also those of vehicles that enter an intersection later."""
    RoadPair(env_id, {"other_vehicles_type": kind}).drive([33], decisions=12)


@pytest.mark.slow
@pytest.mark.parametrize("env_id", ROADS)
@pytest.mark.parametrize("kind", LINEAR)
def test_five_episodes_among_vehicles_of_the_linear_model_are_the_same(env_id, kind):
    RoadPair(env_id, {"other_vehicles_type": kind}).drive(range(1_000, 1_005))


@pytest.mark.slow
@pytest.mark.parametrize("env_id", ROADS)
def test_fifteen_episodes_are_the_same(env_id):
    assert RoadPair(env_id).drive(range(1_000, 1_015)) == 15


@pytest.mark.slow
@pytest.mark.parametrize("env_id", sorted(CONFIGS))
def test_ten_episodes_of_another_configuration_are_the_same(env_id):
    RoadPair(env_id, CONFIGS[env_id]).drive(range(2_000, 2_010))


@given(
    features=st.lists(st.sampled_from(FEATURES), min_size=1, max_size=8, unique=True),
    count=st.integers(2, 16),
    options=st.fixed_dictionaries(
        {
            **{k: st.booleans() for k in ("absolute", "normalize", "clip", "see_behind", "observe_intentions")},
            "include_obstacles": st.booleans(),
            "order": st.sampled_from(["sorted", "shuffled"]),
        }
    ),
    env_id=st.sampled_from(["merge-v0", "roundabout-v1", "exit-v0", "two-way-v0"]),
    kind=st.sampled_from(["Kinematics", "Kinematics", "ExitObservation"]),
    seed=st.integers(0, 50),
)
@settings(max_examples=8, deadline=None)
def test_any_kinematics_are_the_same(features, count, options, env_id, kind, seed):
    kind = kind if env_id == "exit-v0" else "Kinematics"
    observation = {"type": kind, "features": features, "vehicles_count": count, **options}
    RoadPair(env_id, {"observation": observation}).drive([seed], decisions=2)


def test_episodes_follow_as_in_gymnasiums_vector_environment():
    config = {"duration": 3}
    mine, kind = RoadVectorEnv("roundabout-v0", 2, config), {"autoreset_mode": gym.vector.AutoresetMode.SAME_STEP}
    theirs = gym.make_vec("roundabout-v0", 2, vectorization_mode="sync", vector_kwargs=kind, config=config)
    assert mine.single_observation_space == theirs.single_observation_space
    assert np.array_equal(mine.reset(seed=5)[0], theirs.reset(seed=5)[0])
    rng, ends = np.random.default_rng(0), 0
    for _ in range(8):
        actions = rng.integers(5, size=2)
        *one, info = mine.step(actions)
        *two, known = theirs.step(actions)
        for a, b in zip(one, two, strict=True):
            assert np.array_equal(a, b)
        ended = one[2] | one[3]
        ends += ended.sum()
        assert ("final_obs" in info) == ("final_obs" in known) == ended.any()
        for i in np.flatnonzero(ended):
            assert np.array_equal(info["final_obs"][i], known["final_obs"][i])
    assert ends > 2


def test_a_live_environment_continues_in_the_arrays():
    pair = RoadPair("intersection-v0")
    pair.env.reset(seed=3)
    for _ in range(3):
        pair.env.step(1)
    pair.simulator.load(pair.env)
    pair.decisions = 3
    for action in (2, 0, 1, 2):
        if pair.step(action):
            break


def test_several_threads_give_the_results_of_a_single_thread():
    one, two = RoadSimulator("roundabout-v0", 5), RoadSimulator("roundabout-v0", 5, threads=2)
    for simulator in (one, two):
        simulator.reset(range(5))
        for _ in range(4):
            simulator.step([3, 1, 0, 2, 4], again=True)
    assert np.array_equal(one.episodes.worlds.f, two.episodes.worlds.f)
    assert np.array_equal(one.seen.observations, two.seen.observations)


def test_unsupported_episodes_are_refused():
    for env_id, config, message in (
        ("highway-v0", None, "HighwayEnv are not compiled; those of MergeEnv"),
        ("racetrack-v0", None, "RacetrackEnv are not compiled"),
        ("merge-v0", {"observation": {"type": "LidarObservation"}}, "observation LidarObservation"),
        ("merge-v0", {"action": {"type": "ContinuousAction"}}, "its own reward does not take"),
        ("merge-v0", {"vehicles": 3, "show_trajectories": True}, "vehicles=3; show_trajectories"),
        ("exit-v0", {"other_vehicles_type": "highway_env.vehicle.controller.MDPVehicle"}, "MDPVehicle"),
        ("intersection-v0", {"controlled_vehicles": 2}, "controlled_vehicles=2"),
        ("intersection-v0", {"destination": "ir1"}, "o0 to o3, not 'ir1'"),
    ):
        with pytest.raises(ConfigError, match=message):
            RoadSimulator(env_id, 1, config)
    simulator = RoadSimulator("merge-v0", 2)
    with pytest.raises(ActionError, match="have 2 meta-actions from 0 to 4"):
        simulator.step([5, 0])
    with pytest.raises(ConfigError, match="environments 0 to 1"):
        simulator.reset(which=[2])
    with pytest.raises(SceneError, match="another configuration"):
        simulator.load(gym.make("merge-v0", config={"duration": 1}))


def test_more_vehicles_than_array_rows_are_an_error(monkeypatch):
    monkeypatch.setattr("dynamics.road_networks.episodes.scenario._MOST", 1)
    simulator = RoadSimulator("intersection-v0", 20, {"spawn_probability": 1.0, "initial_vehicle_count": 1})
    simulator.step(np.ones(20, int))
    with pytest.raises(SceneError, match="has room for 3 vehicles, and more came"):
        simulator.step(np.ones(20, int))


def test_the_number_of_environments_comes_after_their_id():
    with pytest.raises(ConfigError, match="takes the id of an environment first, not 2"):
        RoadVectorEnv(2, "roundabout-v0")
