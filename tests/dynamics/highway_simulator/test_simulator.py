"""The compiled highway equals highway-env's to the last bit, for any configuration, start and length.

Where this machine's numpy computes sums of products in an unknown way (`Simulator.exact`), it does so to 1e-9.
"""

import numpy as np
import pytest
from highway_env.vehicle.objects import Obstacle
from live_highway import CONTINUOUS, drive_live, live
from random_highways import place
from simulator_pair import DRIVERS, SMALL, Pair, drive

from dynamics.highway_simulator.observe import FEATURES

ROAD = 10_000.0

# Episodes


def test_episodes_as_configured_by_default_are_the_same():
    pair = Pair("highway-fast-v0")
    pair.reset([3])
    pair.drive(12, np.random.default_rng(3))


def test_traffic_that_looks_for_collisions_is_the_same():
    drive({"vehicles_count": 12, "vehicles_density": 4.0}, seeds=(0, 1), decisions=12, env_id="highway-v0")


@pytest.mark.parametrize("driver", DRIVERS, ids=lambda path: path.rsplit(".", 1)[1])
def test_traffic_of_every_kind_is_the_same(driver):
    drive({"other_vehicles_type": driver, "vehicles_density": 3.0, "lanes_count": 2})


@pytest.mark.parametrize("frequencies", [(2, 1), (15, 7), (10, 3), (31, 0.5), (5, 5), (60, 2)])
def test_frames_and_decisions_of_any_length_are_the_same(frequencies):
    simulation, policy = frequencies
    drive({"simulation_frequency": simulation, "policy_frequency": policy, "vehicles_count": 4}, decisions=8)


@pytest.mark.parametrize("lanes", [1, 2, 8])
@pytest.mark.parametrize("first", [None, 0])
def test_roads_of_any_width_are_the_same(lanes, first):
    drive({"lanes_count": lanes, "initial_lane_id": first, "ego_spacing": 0.2, "vehicles_density": 6.0}, decisions=8)


@pytest.mark.parametrize("vehicles", [0, 1])
def test_an_empty_road_is_the_same(vehicles):
    drive({"vehicles_count": vehicles})


@pytest.mark.parametrize(
    "action",
    [
        {"longitudinal": False},
        {"lateral": False},
        {"target_speeds": [0, 10, 20, 30, 40]},
        {"target_speeds": [-5.0, 12.5, 13.0, 50.0]},
        {"target_speeds": [30, 20]},
    ],
    ids=str,
)
def test_meta_actions_of_every_kind_are_the_same(action):
    drive({"action": {"type": "DiscreteMetaAction", **action}})


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    "action",
    [
        {},
        {"longitudinal": False},
        {"lateral": False},
        {"clip": False},
        {"acceleration_range": [-9.7, 3.1], "steering_range": [-1.4, 0.6], "speed_range": [-12.0, 47.0]},
        {"acceleration_range": (np.float64(-3.3), np.float64(3.3))},
    ],
    ids=str,
)
def test_throttle_and_steering_of_every_kind_are_the_same(action, dtype):
    drive({"action": {**CONTINUOUS, **action}, "vehicles_count": 3}, seeds=(0, 1), dtype=dtype, scale=1.5)


def test_an_ego_that_leaves_the_road_spins_and_reverses_is_the_same():
    pair = Pair("highway-fast-v0", {**SMALL, "action": CONTINUOUS, "vehicles_count": 2})
    for steering in (0.9, -0.5):
        pair.reset([2])
        for decision in range(20):
            pair.step([np.array([0.3 if decision < 3 else -1.0, steering], dtype=np.float32)])
        base = pair.envs[0].unwrapped
        assert base.vehicle.speed < -1
        assert not base.vehicle.on_road
        assert abs(base.vehicle.heading) > np.pi


@pytest.mark.parametrize(
    "rewards",
    [
        {"collision_reward": 0, "right_lane_reward": 0, "high_speed_reward": 0},
        {"collision_reward": 1.0, "right_lane_reward": 0.0, "high_speed_reward": -1},
        {"collision_reward": 0.3, "right_lane_reward": 0.2, "high_speed_reward": 0.1},
        {"on_road_reward": -0.7, "normalize_reward": False},
        {"reward_speed_range": [25, 25], "ego_spacing": 1},
        {"reward_speed_range": [30, 20], "normalize_reward": False},
    ],
    ids=str,
)
def test_rewards_of_any_weights_are_the_same(rewards):
    drive(rewards, seeds=(0, 1, 2), decisions=12)


def test_an_episode_ends_off_the_road_where_it_should():
    pair = Pair("highway-fast-v0", {**SMALL, "action": CONTINUOUS, "offroad_terminal": True, "vehicles_count": 1})
    pair.reset([0])
    ends = [pair.step([np.array([0.0, 0.2])])[0] for _ in range(4)]
    assert ends[-1]
    assert not pair.envs[0].unwrapped.vehicle.on_road


def test_driving_on_after_a_crash_is_the_same():
    pair = Pair("highway-v0", {**SMALL, "vehicles_density": 6.0, "lanes_count": 1, "action": CONTINUOUS})
    pair.reset([0])
    for _ in range(20):
        pair.step([np.array([1.0, 0.0])])
    assert sum(vehicle.crashed for vehicle in pair.envs[0].unwrapped.road.vehicles) > 1


def test_hundreds_of_decisions_are_the_same():
    pair = Pair("highway-fast-v0", {"vehicles_count": 2, "lanes_count": 2, "duration": 1000})
    pair.reset([5])
    pair.drive(400, np.random.default_rng(0))
    assert pair.decision == 400


def test_the_end_of_the_road_is_the_same():
    env = live({"action": {"type": "DiscreteMetaAction", "target_speeds": [20, 30, 40]}})
    for k, vehicle in enumerate(env.unwrapped.road.vehicles):
        place(vehicle, ROAD - 60 * (k + 1), 4.0 * (k % 3), 28.0)
    drive_live(env, 15)
    assert all(vehicle.position[0] > ROAD + 10 for vehicle in env.unwrapped.road.vehicles[:4])


# Observations


@pytest.mark.parametrize(
    "observation",
    [
        {"features": list(FEATURES)},
        {"features": list(reversed(FEATURES)), "normalize": False},
        {"absolute": True, "see_behind": True},
        {"absolute": True, "clip": False},
        {"vehicles_count": 2},
        {"vehicles_count": 30, "see_behind": True},
        {"features": ["heading", "x", "long_off"], "features_range": {"x": [-30, 60], "heading": [-0.1, 0.2]}},
        {"features_range": {"vx": [0, 0]}},
        {"include_obstacles": False, "observe_intentions": True},
    ],
    ids=str,
)
def test_observations_of_every_kind_are_the_same(observation):
    drive({"observation": {"type": "Kinematics", **observation}}, decisions=8)


@pytest.mark.parametrize(
    "observation",
    [
        {},
        {"features": ["presence", "x", "y", "vx", "vy", "heading", "cos_h", "sin_h", "lat_off", "on_road"]},
        {"grid_size": [[-40, 60], [-12, 12]], "grid_step": [3, 3]},
        {
            "features": ["vx", "on_road"],
            "features_range": {"vx": [-9, 9], "x": [-99, 99], "y": [-70, 90]},
            "clip": False,
        },
        {"grid_size": [[-18, 18], [-18, 18]], "grid_step": [0.7, 1.3]},
    ],
)
def test_grids_of_every_kind_are_the_same(observation):
    drive({"observation": {"type": "OccupancyGrid", **observation}}, decisions=10)


@pytest.mark.parametrize("rows", [2, 3, 5, 17])
def test_a_shuffled_order_is_drawn_in_the_same_way(rows):
    drive({"observation": {"type": "Kinematics", "order": "shuffled", "vehicles_count": rows}}, seeds=(0, 1, 2, 3))


def test_obstacles_are_observed_in_the_same_way():
    observation = {"type": "Kinematics", "features": list(FEATURES), "see_behind": True, "vehicles_count": 9}
    for extra in ({}, {"normalize": False}, {"features_range": {"heading": [-1, 1], "long_off": [0, 1], "x": [0, 9]}}):
        env = live({"observation": {**observation, **extra}})
        base = env.unwrapped
        for along, across in ((30.0, 0.0), (-30.0, 2.0), (8.0, 6.0)):
            at = base.vehicle.position + np.array([along, across])
            base.road.objects.append(Obstacle(base.road, at, heading=0.3))
        drive_live(env, 4)


# Generators and resets


@pytest.mark.parametrize("seed", [0, 1, 2**32 - 1, 2**32, 2**62 + 12345, 2**63 - 1])
def test_any_seed_makes_the_same_scene(seed):
    Pair("highway-fast-v0", SMALL).reset([seed])


def test_resets_without_a_seed_go_on_with_the_generator():
    pair = Pair("highway-fast-v0", {**SMALL, "other_vehicles_type": DRIVERS[1]}, num_envs=2)
    pair.reset([7, 8])
    for _ in range(3):
        pair.reset()
        pair.drive(2, np.random.default_rng(0))


@pytest.mark.parametrize("order", ["sorted", "shuffled"])
def test_copies_that_start_again_by_themselves_are_separate_environments(order):
    observation = {"type": "Kinematics", "order": order}
    pair = Pair("highway-fast-v0", {**SMALL, "duration": 4, "observation": observation, "vehicles_count": 4}, 3)
    pair.reset([1, 2, 3])
    rng, ends = np.random.default_rng(0), 0
    for _ in range(15):
        ends += sum(pair.step([int(rng.integers(5)) for _ in pair.envs], again=True))
    assert ends >= 9
