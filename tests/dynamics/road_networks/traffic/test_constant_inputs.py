"""An ego with throttle and steering on any road: the compiled network equals highway-env's, bit for bit."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from input_scenes import InputPair, make_inputs
from network_pair import INTERSECTIONS, wild_scene

from dynamics.highway_simulator.layout import HEADING, SPEED, TARGET, X, Y
from dynamics.road_networks.geometry.layout import USES_CONTROLLERS
from dynamics.road_networks.simulation.simulator import NetworkSimulator

ROADS = (
    "merge-v0",
    "merge-v1",
    "merge-generic-v1",
    "roundabout-v0",
    "roundabout-v1",
    "roundabout-generic-v0",
    "exit-v0",
    "two-way-v0",
    "u-turn-v0",
    "u-turn-v1",
    "highway-fast-v0",
    "highway-v0",
    "racetrack-v0",
    "racetrack-large-v0",
    "racetrack-oval-v0",
)


def drive(pair, rng, decisions):
    """Inputs that keep the road for a while, and then leave it."""
    frames = int(pair.env.config["simulation_frequency"] // pair.env.config["policy_frequency"])
    for _ in range(decisions):
        pair.frames(np.clip(rng.normal([0.3, 0.0], [0.6, 0.08]), -1, 1), frames)
        if hasattr(pair.env, "_clear_vehicles"):
            pair.env._clear_vehicles()
            pair.env._spawn_vehicle(spawn_probability=0.5)
            pair.start()


@pytest.mark.parametrize("env_id", [*ROADS, *INTERSECTIONS])
@pytest.mark.parametrize("dynamical", [False, True])
def test_an_episode_is_the_same(env_id, dynamical):
    drive(InputPair(env_id, 500, dynamical), np.random.default_rng(0), 7)


@pytest.mark.slow
@pytest.mark.parametrize("env_id", [*ROADS, *INTERSECTIONS])
@pytest.mark.parametrize("dynamical", [False, True])
def test_forty_episodes_are_the_same(env_id, dynamical):
    for seed in range(4_000, 4_040):
        drive(InputPair(env_id, seed, dynamical), np.random.default_rng(seed), 20)


def drive_wild(env_id, seed, dynamical=False):
    pair, rng = wild_scene(env_id, seed, lambda *names: InputPair(*names, dynamical))
    for _ in range(8):
        pair.frames(np.clip(rng.normal([0.3, 0.0], [0.6, 0.1]), -1, 1), 15)
        if hasattr(pair.env, "_clear_vehicles"):
            pair.env._clear_vehicles()
            pair.start()


@pytest.mark.parametrize("env_id", ["merge-v1", "roundabout-v0", "exit-v1", "u-turn-v1", "intersection-v2"])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_random_scene_of_inputs_is_the_same(env_id, seed):
    drive_wild(env_id, seed, seed == 2)


@pytest.mark.slow
@pytest.mark.parametrize("env_id", [*ROADS, *INTERSECTIONS])
def test_fifty_random_scenes_of_inputs_are_the_same(env_id):
    for seed in range(5_000, 5_050):
        drive_wild(env_id, seed, seed % 2 == 0)


def test_vehicles_are_removed_when_highway_env_removes_them():
    """After the decisions of the environment, whenever the ego's inputs change; the copy finds out by itself."""
    vanished = 0
    for seed in range(510, 514):
        pair = InputPair("intersection-v0", seed)
        there = len(pair.env.road.vehicles)
        for _ in range(12):
            for _ in range(15):
                pair.frames(np.zeros(2), 1)
            pair.env._clear_vehicles()
        vanished += there - len(pair.env.road.vehicles)
    assert vanished > 0


def test_the_target_lane_of_the_braking_law_does_not_affect_other_vehicles():
    """A vehicle gives up a lane change if another has the same target lane; a car without meta-actions has none."""
    pair = InputPair("highway-fast-v0", 0)
    env = pair.env
    road, ego = env.road, env.vehicle
    other = road.vehicles[1]
    road.vehicles = [ego, other]
    ego.position, ego.speed = road.network.get_lane(("0", "1", 2)).position(212, 0), 20.0
    other.position, other.speed = road.network.get_lane(("0", "1", 0)).position(200, 0), 20.0
    for each in (ego, other):
        each.heading = 0.0
        each.on_state_update()
    other.target_lane_index, other.timer = ("0", "1", 1), 0.0
    pair.start()
    pair.simulator.worlds.g[0, TARGET, 0] = 1
    for _ in range(6):
        pair.frames(np.zeros(2), 1)
        assert pair.simulator.worlds.g[0, TARGET, 1] == other.target_lane_index[2] == 1


@pytest.mark.parametrize("env_id", ["roundabout-v1", "u-turn-v0", "merge-v1"])
def test_the_law_is_highway_envs_controllers(env_id):
    """Held to lanes and speeds by the law, alone on the road, the ego drives as with meta-actions."""
    meta, inputs = gym.make(env_id).unwrapped, make_inputs(env_id).unwrapped
    for env in (meta, inputs):
        env.reset(seed=3)
        env.road.vehicles = [env.vehicle]
        env.road.objects = []
    ego, plain = meta.vehicle, inputs.vehicle
    plain.position, plain.heading, plain.speed = ego.position.copy(), ego.heading, ego.speed
    ego.route, ego.target_speed = None, ego.speed
    law = NetworkSimulator(inputs, control_limits=(1e9, 1e9, 1.0))
    simulator = NetworkSimulator(meta)
    for action in (1, 0, 1, 2, 1):
        mine, theirs = law.step(action), simulator.step(action)
        assert law.worlds.g[0, USES_CONTROLLERS, 0] == 1
        assert np.array_equal(mine, theirs)


def test_the_accelerations_of_the_law_are_bounded():
    env = make_inputs("highway-fast-v0").unwrapped
    env.reset(seed=0)
    env.road.vehicles = env.road.vehicles[:1]
    law = NetworkSimulator(env, control_limits=(9.8, 5.0, 1.0))
    speeds = [law.worlds.f[0, SPEED, 0]]
    for action in (4, 4, 4, 3, 3, 3):
        speeds += [row[0, 3] for row in law.step(action)]
    rates = np.diff(speeds) * 5
    assert rates.min() == pytest.approx(-9.8)
    assert rates.max() == pytest.approx(5.0)


def test_a_held_input_ends_the_law():
    env = make_inputs("highway-fast-v0").unwrapped
    env.reset(seed=0)
    simulator = NetworkSimulator(env)
    simulator.step(3)
    f, g = simulator.worlds.f[0], simulator.worlds.g[0]
    before = f[[X, Y, HEADING, SPEED], 0].copy()
    simulator.hold(0.0, 0.0, 1)
    assert g[USES_CONTROLLERS, 0] == 0
    assert f[SPEED, 0] == before[3]
