"""A vehicle with a number that is not finite breaks a rule by that; the other vehicles are judged as always."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from highway_env.vehicle.kinematics import Vehicle

from shield import ShieldedEnv

HIGHWAY = {"lanes_count": 3, "vehicles_count": 1, "simulation_frequency": 15, "policy_frequency": 5}
INPUTS = {"action": {"type": "ContinuousAction"}}


class Parked(Vehicle):
    """A vehicle that stands, or drives straight on at constant speed, whatever its other numbers are."""

    def act(self, action=None):
        pass

    def step(self, dt):
        if np.isfinite(self.speed):
            self.position = self.position + np.array([self.speed * dt, 0.0])


def spoil(body, column):
    if column in ("LENGTH", "heading", "speed"):
        setattr(body, column, np.nan)
    else:
        body.position = np.array([np.inf, 0.0])


def on_highway(inputs):
    """An ego, a leader 18 m ahead at its speed, and a vehicle that is far away."""
    env = ShieldedEnv(gym.make("highway-v0", config={**HIGHWAY, **(INPUTS if inputs else {})}), "worst-case")
    env.reset(seed=0)
    base = env.unwrapped
    ego, road = base.vehicle, base.road
    ego.position, ego.heading, ego.speed = np.array([300.0, 4.0]), 0.0, 25.0
    if not inputs:
        ego.target_lane_index, ego.speed_index, ego.target_speed = ("0", "1", 1), 1, 25.0
    ego.on_state_update()
    road.vehicles = [ego, Parked(road, [318.0, 4.0], 0.0, 25.0), Parked(road, [900.0, 0.0], 0.0, 25.0)]
    env.filter.reset()
    return env, road.vehicles[1], road.vehicles[2], np.zeros(2, np.float32) if inputs else 1


@pytest.mark.parametrize("inputs", [False, True], ids=["meta-actions", "inputs"])
@pytest.mark.parametrize(
    ("column", "rule"), [("position", "way"), ("heading", "way"), ("speed", "speed"), ("LENGTH", "size")]
)
def test_an_unreadable_vehicle_on_a_highway_is_one_violation_and_the_others_are_judged(inputs, column, rule):
    env, leader, far, idle = on_highway(inputs)
    env.step(idle)
    assert not env.filter.by_rule
    spoil(far, column)
    assert env.step(idle)[-1]["shield"]["reason"] == "bad_scene"
    assert env.filter.by_rule == {rule: 1}
    env.step(idle)
    assert env.filter.by_rule == {rule: 1}
    leader.speed = 0.0
    env.step(idle)
    assert env.filter.violations == 2
    assert env.filter.by_rule["speed"] == (2 if rule == "speed" else 1)


@pytest.mark.parametrize(
    ("column", "value", "rule"), [("LENGTH", 1e308, "size"), ("WIDTH", -2.0, "size"), ("speed", 1e9, "speed")]
)
def test_a_vehicle_of_impossible_size_or_speed_is_a_violator(column, value, rule):
    """highway-env treats a negative width as the same rectangle, sums of such lengths are not finite, and braking
    changes nothing at such speeds."""
    env, _, far, idle = on_highway(False)
    env.step(idle)
    setattr(far, column, value)
    far.step = lambda dt: None
    assert env.step(idle)[-1]["shield"]["reason"] == "bad_scene"
    assert env.filter.by_rule == {rule: 1}


def test_a_long_body_counts_if_its_rear_is_near():
    """Its centre is beyond the perception range, and its rear 30 m ahead."""
    env, leader, _, idle = on_highway(False)
    leader.LENGTH, leader.speed = 360.0, 0.0
    leader.position = np.array([300.0 + 30.0 + 180.0, 4.0])
    env.filter.reset()
    env.step(idle)
    assert env.decisions[0].tier.fallback


def test_an_unreadable_vehicle_in_the_last_frame_is_reported():
    env, _, far, idle = on_highway(False)
    env.unwrapped.config["duration"] = 0.5
    env.step(idle)
    env.step(idle)
    far.step = lambda dt: spoil(far, "speed")
    *_, truncated, info = env.step(idle)
    assert truncated
    assert info["shield"]["rules"] == {"speed": 1}


@pytest.mark.parametrize("env_id", ["roundabout-v0", "merge-v0"])
@pytest.mark.parametrize(("column", "rule"), [("heading", "ways"), ("speed", "speed"), ("LENGTH", "grown")])
def test_an_unreadable_vehicle_on_a_network_is_one_violation_and_the_others_are_judged(env_id, column, rule):
    env = ShieldedEnv(gym.make(env_id, config={"policy_frequency": 5}), "worst-case")
    env.reset(seed=3)
    road, ego = env.unwrapped.road, env.unwrapped.vehicle
    lanes = [(a, b, i) for a, to in road.network.graph.items() for b in to for i in range(len(to[b]))]
    lane = road.network.get_lane(
        max(lanes, key=lambda key: np.linalg.norm(road.network.get_lane(key).position(5, 0) - ego.position))
    )
    far, other = (Parked(road, lane.position(s, 0), lane.heading_at(s), 0.0) for s in (5.0, 15.0))
    road.vehicles = [ego, far, other]
    env.filter.reset()
    env.step(1)
    assert not env.filter.by_rule
    spoil(far, column)
    assert env.step(1)[-1]["shield"]["reason"] == "bad_scene"
    assert env.filter.by_rule == {rule: 1}
    other.speed = 20.0
    env.step(1)
    assert env.filter.by_rule == ({"speed": 2} if rule == "speed" else {rule: 1, "speed": 1})
