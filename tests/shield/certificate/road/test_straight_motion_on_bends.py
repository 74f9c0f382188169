"""Straight motion on a bend: highway-env tests for crashes with a frame of motion along the heading, which leads off
the bend. Bodies in a lane beside do not crash the ego by it while a plan verifies and no rule is violated."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import given
from hypothesis import strategies as st

from dynamics.roads.path_reader import read_network
from dynamics.traffic.assumptions import Assumptions
from dynamics.traffic.motion_limits import bend_speed_of
from dynamics.traffic.occupancy import OtherVehicles
from dynamics.traffic.occupancy_kernels import straight_overshoot
from dynamics.traffic.rules_of_the_road import EgoFootprint, RoadRule, rule_violations
from shield import ShieldedEnv

INPUTS = {"type": "ContinuousAction", "longitudinal": True, "lateral": True}


class LaneFollower(Vehicle):
    """A body that keeps to a lateral position of a road at given speeds, with its heading along the road."""

    def __init__(self, base, road, place, size, speeds):
        super().__init__(base.road, [0.0, 0.0])
        self.LENGTH, self.WIDTH = size
        self.diagonal = float(np.hypot(*size))
        self.on, self.s, self.r, self.speeds = road, place[0], place[1], list(speeds)
        self.place()

    def place(self):
        x, y, heading, _ = self.on.to_world(np.array([[self.s, self.r, 0.0, 0.0]]))[0]
        self.position, self.heading, self.speed = np.array([x, y]), heading, self.speeds[0]
        self.on_state_update()

    def act(self, action=None):
        pass

    def step(self, dt):
        self.s += self.speeds[0] * dt
        if len(self.speeds) > 1:
            self.speeds.pop(0)
        self.place()


def bend_of(road, nth):
    s = np.arange(0.0, road.length, 1.0)
    return float(s[np.argsort(-np.abs([float(road.curvature(np.array(x))) for x in s]))[nth]])


def driven(hz, size, speeds, ahead, nth, frames=12, aside=0.0):
    """Whether the ego, which stands in a bend, crashes; whether a plan verified before; and the violations."""
    config = {"simulation_frequency": hz, "policy_frequency": hz, "duration": 1e5, "action": INPUTS}
    env = ShieldedEnv(gym.make("racetrack-oval-v0", disable_env_checker=True, config=config), "worst-case")
    env.reset(seed=0)
    base = env.unwrapped
    road = read_network(base.road.network)
    s = bend_of(road, nth)
    x, y, heading, _ = road.to_world(np.array([[s, road.centers[1] + aside, 0.0, 0.0]]))[0]
    ego = base.vehicle
    ego.position, ego.heading, ego.speed = np.array([x, y]), heading, 0.0
    ego.on_state_update()
    base.road.vehicles[:] = [LaneFollower(base, road, (s - ahead, 0.2), size, speeds), ego]
    env.filter.reset()
    verified = False
    for _ in range(frames):
        *_, terminated, truncated, _ = env.step(np.zeros(2, np.float32))
        if ego.crashed or terminated or truncated:
            break
        verified = verified or env.frame_decisions[-1].margin >= 0
    return bool(ego.crashed), verified, dict(env.filter.by_rule)


@given(st.floats(8.0, 500.0), st.floats(1.0, 20.0), st.floats(0.5, 3.0), st.floats(0.0, 9.0))
def test_a_body_leaves_its_bend_by_no_more_than_the_bound(radius, length, width, distance):
    corner = np.hypot(radius + 0.5 * width, 0.5 * length + distance) - radius - 0.5 * width
    chord = length**2 / (8 * radius)
    assert corner <= straight_overshoot(1 / radius, length, distance) + chord + 1e-9


@pytest.mark.parametrize("nth", [0, 21])
@pytest.mark.parametrize(
    ("hz", "size", "speed", "before"),
    [(5, (5.0, 2.0), 40.0, 1.1), (5, (12.0, 2.6), 20.0, -2.2), (10, (12.0, 2.6), 40.0, -2.2)],
)
def test_a_body_too_fast_for_the_bend_crashes_no_ego_that_counted_as_safe(hz, size, speed, before, nth):
    crashed, verified, violations = driven(hz, size, [speed], before, nth)
    assert not crashed or not verified or violations


@pytest.mark.parametrize("hz", [5, 10, 15])
@pytest.mark.parametrize("size", [(5.0, 2.0), (12.0, 2.6)])
def test_a_body_as_fast_as_a_bend_permits_passes_a_standing_ego(hz, size):
    road = read_network(gym.make("racetrack-oval-v0", disable_env_checker=True).unwrapped.road.network)
    speed = bend_speed_of(Assumptions.idm(), road.bends.tightest)
    found = [driven(hz, size, [speed], 6.0 + shift, nth) for shift in (0.0, 0.7) for nth in (0, 21)]
    assert not any(crashed for crashed, _, _ in found)
    assert all(violations == {} for _, _, violations in found)
    truck_at_five = hz == 5 and size[0] > 5.0
    assert any(verified for _, verified, _ in found) or truck_at_five


def test_a_body_that_speeds_up_in_a_bend_is_named_before_it_crashes_the_ego():
    speeds = [10.0]
    while speeds[-1] < 30.0:
        speeds.append(speeds[-1] + min(1.2, 0.2 * 75.0 / speeds[-1]))
    found = [driven(5, (5.0, 2.0), speeds, sum(speeds[:k]) / 5 + 5.0, 0, frames=k + 5) for k in (20, 24)]
    assert all(verified and violations == {"way": 1} for _, verified, violations in found)


def test_a_far_body_is_named_that_takes_the_room_of_the_stop_by_its_speed():
    """The ego stands beside the middle of its lane, and the body drives away from it."""
    speeds = [10.0] * 5 + [10.0 + 0.8 * k for k in range(12)]
    _, verified, violations = driven(5, (5.0, 2.0), speeds, -40.0, 0, frames=16, aside=0.4)
    assert verified
    assert violations == {"way": 1}


@pytest.mark.parametrize(("speeds", "grows"), [((8.0, 9.0), False), ((14.0, 14.5), True), ((14.5, 14.0), False)])
def test_speed_on_a_bend_counts_as_more_room(speeds, grows):
    road = read_network(gym.make("racetrack-oval-v0", disable_env_checker=True).unwrapped.road.network)
    assert 9.0 < bend_speed_of(Assumptions.idm(), road.bends.tightest) < 14.0

    def around(s, v, before=None):
        states = np.array([[s, 0.0, 0.0, v]])
        rows = np.hstack([road.to_world(states), [[5.0, 2.0, 0.0]]])
        return OtherVehicles(rows, states, road, Assumptions.idm(), 0.2, before)

    far = EgoFootprint(1e6, 0.0, 0.0, 0.0, 4.5, 1.3, 2.5, 1.0, False)
    first = around(20.0, speeds[0])
    found = rule_violations(first, around(20.0 + 0.2 * speeds[0], speeds[1], first), 0.2, np.zeros(1, bool), far)
    assert found.broken.tolist() == [0]
    assert bool(found.grown[0] & RoadRule.WAY) == grows
