"""Options that the compiled highway does not support are refused; none is silently replaced."""

import gymnasium as gym
import numpy as np
import pytest
import simulator_pair
from highway_env.envs.highway_env import HighwayEnvFast
from highway_env.vehicle.behavior import IDMVehicle, LinearVehicle
from live_highway import CONTINUOUS, same_or_refused
from simulator_pair import SMALL, Pair, drive

from dynamics.errors import ActionError, ConfigError, ShieldError
from dynamics.highway_simulator.simulator import Simulator


class _Timid(IDMVehicle):
    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.target_speed = 10.0


class _Slow(IDMVehicle):
    @classmethod
    def create_random(cls, road, **kwargs):
        vehicle = super().create_random(road, **kwargs)
        vehicle.target_speed = 5.0
        return vehicle


class _Close(IDMVehicle):
    def lane_distance_to(self, other, lane=None):
        return super().lane_distance_to(other, lane) - 4.0


class _Blind(IDMVehicle):
    def to_dict(self, *args, **kwargs):
        return {**super().to_dict(*args, **kwargs), "x": 0.0}


class _Straight(LinearVehicle):
    def steering_features(self, target_lane_index):
        return np.zeros(2)


class _Eager(LinearVehicle):
    def acceleration_features(self, *args):
        return np.ones(3)


class _Lazy(IDMVehicle):
    KP_LATERAL = 0.5


class _Stiff(IDMVehicle):
    MAX_STEERING_ANGLE = 0.01


@pytest.mark.parametrize("kind", [_Timid, _Slow, _Close, _Blind, _Straight, _Eager, _Lazy, _Stiff])
def test_traffic_with_its_own_driver_model_is_refused_or_the_same(kind, monkeypatch):
    monkeypatch.setattr(simulator_pair, kind.__name__, kind, raising=False)
    path = f"simulator_pair.{kind.__name__}"
    same_or_refused(lambda: drive({"other_vehicles_type": path, "vehicles_density": 3.0}, decisions=8))


@pytest.mark.parametrize(
    "config",
    [
        {"observation": {"type": "Kinematics", "vehicles_count": 1}},
        {"observation": {"type": "Kinematics", "vehicles_count": 0}},
        {"observation": {"type": "Kinematics", "order": "none"}},
        {"observation": {"type": "Kinematics", "features": ["x", "x"]}},
        {"observation": {"type": "Kinematics", "features": ["x", "colour"]}},
        {"observation": {"type": "OccupancyGrid", "as_image": True}},
        {"observation": {"type": "OccupancyGrid", "align_to_vehicle_axes": True}},
        {"observation": {"type": "OccupancyGrid", "absolute": True}},
        {"observation": {"type": "OccupancyGrid", "features": ["on_road", "colour"]}},
        {"observation": {"vehicles_count": 5}},
        {"action": {}},
        {"action": {"type": "DiscreteAction"}},
        {"action": {"type": "ContinuousAction", "dynamical": True}},
        {"action": {"type": "DiscreteMetaAction", "target_speeds": [20]}},
        {"action": {"type": "DiscreteMetaAction", "target_speeds": [20, 25, 20]}},
        {"action": {"type": "DiscreteMetaAction", "longitudinal": False, "lateral": False}},
        {"initial_lane_id": 3},
        {"initial_lane_id": -4},
        {"vehicles_count": -3},
        {"vehicles_density": 0},
        {"policy_frequency": 0},
        {"lanes_count": 0},
        {"controlled_vehicles": 2},
        {"other_vehicles_type": "highway_env.vehicle.kinematics.Vehicle"},
        {"other_vehicles_type": "math.sqrt"},
        {"duration": None},
        {"unheard_of": 1},
    ],
    ids=str,
)
def test_an_unsupported_configuration_is_refused(config):
    with pytest.raises(ConfigError):
        Simulator("highway-fast-v0", 1, {**SMALL, **config})


def test_the_last_lane_may_be_configured_as_minus_one():
    same_or_refused(lambda: drive({"initial_lane_id": -1}, decisions=1))


def test_other_environments_are_refused():
    for env_id in ("merge-v0", "intersection-v0", "no-such-v0"):
        with pytest.raises(ConfigError):
            Simulator(env_id)


def test_the_configuration_that_an_environment_is_registered_with_counts():
    gym.register(id="my-highway-v0", entry_point=HighwayEnvFast, kwargs={"config": {"lanes_count": 2}})
    try:
        same_or_refused(lambda: Pair("my-highway-v0").reset([0]))
    finally:
        gym.registry.pop("my-highway-v0")


@pytest.mark.parametrize("which", [2, -3])
def test_a_copy_that_does_not_exist_is_refused(which):
    with pytest.raises(ShieldError):
        Simulator("highway-fast-v0", 2, SMALL).reset([1], which=[which])


def test_seeds_that_highway_env_does_not_take_are_refused():
    simulator = Simulator("highway-fast-v0", 2, SMALL)
    for seeds in ([-1, 0], [0], [2**64, 0]):
        with pytest.raises(ShieldError):
            simulator.reset(seeds)
    with pytest.raises(ConfigError):
        Simulator("highway-fast-v0", 0, SMALL)


def test_actions_outside_the_space_are_refused():
    simulator = Simulator("highway-fast-v0", 2, SMALL)
    for actions in ([0], [0, 5], [-1, 0], [0, np.nan], [[0], [1]]):
        with pytest.raises(ActionError):
            simulator.step(actions)
    simulator = Simulator("highway-fast-v0", 1, {**SMALL, "action": CONTINUOUS})
    for actions in ([[0.0]], [[0.0, np.inf]], [0.0, 0.0]):
        with pytest.raises(ActionError):
            simulator.step(actions)
