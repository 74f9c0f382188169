"""Intersections change the constants of their own traffic only."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from highway_env.vehicle import behavior

from dynamics.highway_simulator.kinds import IDM, LINEAR, constants_of, kind_of
from dynamics.road_networks.episodes.scenario import road_scenario_of
from dynamics.road_networks.episodes.simulator import RoadSimulator
from dynamics.traffic import crossing
from dynamics.traffic.crossing import with_own_traffic
from evaluation.settings import Setting, get_setting
from shield.certificate.simulated.roads import SimulatedRoads

CHANGED = ("DISTANCE_WANTED", "COMFORT_ACC_MAX", "COMFORT_ACC_MIN")
PATH = "highway_env.vehicle.behavior.{}".format


def constants():
    return [getattr(behavior.IDMVehicle, name) for name in CHANGED]


@pytest.mark.parametrize(
    "make",
    [
        lambda: get_setting("intersection").make(),
        lambda: Setting("mine", "intersection-v2", {"duration": 5}).make(),
        lambda: Setting("mine", "highway_env:intersection-v1").make(),
        lambda: Setting("mine", "intersection-multi-agent-v0").make(),
        lambda: road_scenario_of("intersection-v0"),
        lambda: SimulatedRoads("intersection-v0", 1).one(),
    ],
)
def test_an_intersection_changes_no_other_traffic(make):
    before = constants()
    make()
    assert constants() == before


def test_highway_env_s_intersection_changes_other_traffic():
    """The reason for the own traffic class: if this test fails, the class can be removed."""
    before = constants()
    gym.make("intersection-v0")
    assert constants() == [7, 6, -3] != before


@pytest.mark.parametrize("name", ["IDMVehicle", "LinearVehicle", "AggressiveVehicle", "DefensiveVehicle"])
def test_the_own_traffic_of_an_intersection_is_highway_envs_to_the_bit(name):
    """The same seeds, made as they come and with traffic of their own."""
    config = {"other_vehicles_type": PATH(name)}
    rows = []
    for own in (True, False):
        env = Setting("mine", "intersection-v0", config).make() if own else gym.make("intersection-v0", config=config)
        env.reset(seed=3)
        found = []
        for _ in range(8):
            _, reward, *_ = env.step(1)
            found += [[*v.position, v.heading, v.speed, reward] for v in env.unwrapped.road.vehicles]
        rows.append(np.array(found))
    np.testing.assert_array_equal(*rows)


def test_a_merge_is_the_same_after_an_intersection():
    def returned():
        env = get_setting("merge").make()
        env.reset(seed=5)
        return [env.step(1)[1] for _ in range(6)]

    before = returned()
    crossing_env = get_setting("intersection").make()
    crossing_env.reset(seed=0)
    assert returned() == before
    crossing_env.step(1)
    assert returned() == before


def test_a_configured_traffic_class_is_kept():
    trucks = {"other_vehicles_type": "dynamics.traffic.mixed.WithTrucks"}
    assert with_own_traffic("intersection-v0", trucks) == trucks
    assert with_own_traffic("merge-v0", {}) == {}
    assert with_own_traffic("no-such-road-v0", {"a": 1}) == {"a": 1}
    own = with_own_traffic("intersection-v0", {"duration": 7})
    assert own == {"duration": 7, "other_vehicles_type": "dynamics.traffic.crossing.IDMVehicle"}
    assert with_own_traffic("intersection-v0", own) == own


def test_the_simulator_supports_the_own_traffic():
    assert kind_of(crossing.IDMVehicle) == IDM
    assert kind_of(crossing.LinearVehicle) == LINEAR
    simulator = RoadSimulator("intersection-v0", 1)
    for env in (gym.make("intersection-v0"), get_setting("intersection").make()):
        env.reset(seed=1)
        simulator.load(env)
    found = next(v for v in env.unwrapped.road.vehicles if isinstance(v, behavior.IDMVehicle))
    np.testing.assert_array_equal(constants_of(type(found)), simulator.scenario.rules.scene.constants[1])
