"""Scenes on curved roads: read only on request, with s continuous around the ego."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from highway_env.road.lane import CircularLane, StraightLane
from highway_env.road.road import RoadNetwork

from dynamics.errors import SceneError
from dynamics.roads.path import PathRoad
from dynamics.roads.straight import StraightRoad
from dynamics.scenes.scene import LEAST_LAP, Scene, SceneReader, _road_of
from dynamics.state import RoadState


@pytest.mark.parametrize("name", ["racetrack-v0", "racetrack-oval-v0"])
def test_a_curved_road_is_refused_unless_requested(name):
    env = gym.make(name)
    env.reset(seed=0)
    with pytest.raises(SceneError, match="straight parallel lanes"):
        Scene.from_env(env)
    assert isinstance(Scene.from_env(env, curved=True).road, PathRoad)


@pytest.mark.parametrize("name", ["merge-v0", "roundabout-v0"])
def test_a_network_that_branches_is_refused_by_both(name):
    env = gym.make(name)
    env.reset(seed=0)
    for curved in (False, True):
        with pytest.raises(SceneError, match="support"):
            Scene.from_env(env, curved=curved)


def test_a_straight_road_is_the_same_scene_for_both():
    env = gym.make("highway-fast-v0")
    env.reset(seed=3)
    one, two = Scene.from_env(env), Scene.from_env(env, curved=True)
    assert isinstance(two.road, StraightRoad)
    np.testing.assert_array_equal(one.ego_road, two.ego_road)
    np.testing.assert_array_equal(one.others_road, two.others_road)


@pytest.mark.parametrize("seed", range(5))
def test_a_drive_around_the_track_has_the_lanes_of_the_simulator_and_continuous_gaps(seed):
    env = gym.make("racetrack-v0", config={"other_vehicles": 4, "terminate_off_road": False})
    env.reset(seed=seed)
    reader, base, checked = SceneReader(env, curved=True), env.unwrapped, 0
    for _ in range(60):
        scene = reader.read()
        road, ego = scene.road, scene.ego_road
        vehicles = [base.vehicle, *(v for v in base.road.vehicles if v is not base.vehicle)]
        for vehicle, local in zip(vehicles, [ego, *scene.others_road], strict=True):
            lane, index = vehicle.lane, vehicle.lane_index[2]
            across = lane.local_coordinates(vehicle.position)[1]
            if abs(across) < 2.4:
                wanted = road.centers[index] + across
                assert abs(local[RoadState.R] - wanted) < road.deviation + 0.01, (vehicle.lane_index, across)
                checked += 1
        assert np.abs(scene.others_road[:, RoadState.S] - ego[RoadState.S]).max(initial=0) <= road.length / 2
        wheel = -0.5 * (ego[RoadState.R] - 2.5) / 5 - ego[RoadState.HEADING] + 3 * road.curvature(ego[0])
        env.step(np.array([np.clip(wheel, -0.7, 0.7) / (np.pi / 4)], dtype=np.float32))
    assert checked > 60


def oval(straight, radius=20.0):
    """A closed road of one lane."""
    network = RoadNetwork()
    network.add_lane("a", "b", StraightLane([0, 0], [straight, 0]))
    network.add_lane("b", "c", CircularLane([straight, radius], radius, -np.pi / 2, np.pi / 2))
    network.add_lane("c", "d", StraightLane([straight, 2 * radius], [0, 2 * radius]))
    network.add_lane("d", "a", CircularLane([0, radius], radius, np.pi / 2, 3 * np.pi / 2))
    return network


def test_a_lap_on_which_a_vehicle_would_count_from_one_side_only_is_refused():
    half = np.pi * 20.0
    assert _road_of(oval(0.5 * LEAST_LAP - half + 0.1), curved=True).closed
    with pytest.raises(SceneError, match="lap of this closed road is 290 m long; at least 300 m"):
        _road_of(oval(145.0 - half), curved=True)
