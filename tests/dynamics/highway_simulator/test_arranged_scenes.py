"""Arranged or changed scenes continue in the compiled highway as in highway-env."""

import numpy as np
import pytest
from highway_env.vehicle.objects import Landmark, Obstacle
from live_highway import CONTINUOUS, drive_live, live, same_or_refused
from random_highways import place, random_scene
from simulator_pair import SMALL, Pair

from dynamics.errors import ConfigError, SceneError, ShieldError
from dynamics.highway_simulator.simulator import Simulator


@pytest.mark.parametrize("seed", range(24))
def test_an_arranged_scene_continues_in_the_same_way(seed):
    rng = np.random.default_rng(seed)
    pair = Pair.of(random_scene(rng))
    pair.drive(10, rng, scale=float(rng.choice([0.1, 1.0, 2.0])))


@pytest.mark.parametrize("seed", [100, 101, 102, 103])
def test_a_stored_scene_continues_in_the_same_way(seed):
    rng = np.random.default_rng(seed)
    pair = Pair.of(random_scene(rng))
    pair.drive(2, rng)
    for _ in range(3):  # the simulator alone
        action = pair.envs[0].action_space.sample()
        pair.simulator.step(np.asarray([action]))
    pair.simulator.store(pair.envs[0])
    pair.compare_states()
    pair.drive(6, rng)


def test_vehicles_that_come_level_within_a_decision_are_seen_in_the_same_order():
    env = live({"vehicles_count": 3, "simulation_frequency": 4})
    ego, follower, ahead, later = env.unwrapped.road.vehicles
    place(ego, 0.0, 8.0, 20.0)
    place(follower, 20.0, 0.0, 20.0)
    follower.enable_lane_change = False
    place(ahead, 100.0, 0.0)
    place(later, 99.0, 3.0, 4.0)  # on the first lane too; a metre a frame
    ahead.crashed = later.crashed = True
    drive_live(env, 3)


def test_a_vehicle_that_enters_the_road_within_a_frame_is_seen():
    env = live({"vehicles_count": 2, "simulation_frequency": 2})
    ego, entering, follower = env.unwrapped.road.vehicles
    place(ego, -30.0, 8.0, 20.0)
    place(entering, -6.0, 0.0, 40.0)
    place(follower, -20.0, 0.0, 30.0)
    drive_live(env, 4)


def test_a_vehicle_moved_to_another_lane_updates_its_lane():
    env = live()
    vehicle = env.unwrapped.road.vehicles[1]
    place(vehicle, 300.0, 8.0, 20.0, aware=False)
    vehicle.target_lane_index = ("0", "1", 2)
    drive_live(env, 3)


def test_an_enlarged_vehicle_collides_in_the_same_way():
    for kept in (False, True):  # highway-env measures its diagonal once, when it is made
        env = live({"vehicles_count": 10, "vehicles_density": 5.0}, env_id="highway-v0")
        for vehicle in env.unwrapped.road.vehicles:
            vehicle.LENGTH, vehicle.WIDTH = 11.0, 3.5
            if not kept:
                vehicle.diagonal = np.sqrt(vehicle.LENGTH**2 + vehicle.WIDTH**2)
        drive_live(env, 10)


def test_a_range_of_speeds_holds_from_the_first_decision_of_a_live_scene():
    env = live({"action": {**CONTINUOUS, "speed_range": [0, 26]}, "vehicles_count": 1})
    pair = Pair.of(env)
    for _ in range(3):
        pair.step([np.array([1.0, 0.0])])


def test_a_copied_scene_that_ends_starts_again_as_configured():
    env = live({"duration": 3})
    pair = Pair.of(env)
    pair.drive(8, np.random.default_rng(0), again=True)


def test_a_copied_scene_of_other_bodies_does_not_start_again():
    env = live({"duration": 1})
    road = env.unwrapped.road
    road.objects.append(Obstacle(road, [900.0, 0.0]))
    simulator = Simulator.of(env)
    with pytest.raises(ConfigError):
        simulator.step([1], again=True)
    del road.vehicles[2]  # as many bodies as are configured, but not the same
    simulator = Simulator.of(env)
    with pytest.raises(ConfigError):
        simulator.reset([0])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("route", [("0", "1", 0)]),
        ("KP_LATERAL", 0.3),
        ("MAX_STEERING_ANGLE", 0.01),
        ("solid", False),
        ("collidable", False),
        ("act", lambda action=None: None),
    ],
)
def test_vehicles_of_unknown_constants_are_refused_or_the_same(name, value):
    env = live({"vehicles_density": 4.0, "vehicles_count": 10}, seed=3, env_id="highway-v0")
    for vehicle in env.unwrapped.road.vehicles[1:]:
        setattr(vehicle, name, value)
    place(env.unwrapped.road.vehicles[3], *(env.unwrapped.vehicle.position + np.array([3.0, 0.5])), 20.0)
    same_or_refused(lambda: drive_live(env, 8))


@pytest.mark.parametrize(
    ("name", "value"), [("target_speeds", np.arange(5) * 10.0), ("KP_A", 0.2), ("MAX_SPEED", 22.0)]
)
def test_an_ego_of_unknown_constants_is_refused_or_the_same(name, value):
    env = live()
    setattr(env.unwrapped.vehicle, name, value)
    same_or_refused(lambda: drive_live(env, 8))


def test_a_route_of_the_ego_is_refused_or_observed():
    env = live({"observation": {"type": "Kinematics", "features": ["x", "cos_d", "sin_d"]}})
    env.unwrapped.vehicle.plan_route_to("1")
    same_or_refused(lambda: drive_live(env, 3))


def test_scenes_of_another_road_or_of_unknown_objects_are_refused():
    env = live()
    env.unwrapped.road.network.graph["0"]["1"][0].speed_limit = 20
    with pytest.raises(SceneError):
        Simulator.of(env)
    env = live()
    env.unwrapped.road.objects.append(Landmark(env.unwrapped.road, [100.0, 0.0]))
    with pytest.raises(SceneError):
        Simulator.of(env)


def test_an_ego_of_another_kind_than_the_simulators_is_refused():
    for mine, other in (({}, {"action": CONTINUOUS}), ({"action": CONTINUOUS}, {})):
        with pytest.raises(ShieldError):
            Simulator("highway-fast-v0", 1, {**SMALL, **mine}).load(live(other))
