"""A vehicle that turns round while it slides on: highway-env counts a collision where constant velocities along the
headings lead in the coming frame, so the vehicle is named though its body keeps its distance."""

import math

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.roads.straight import StraightRoad
from dynamics.traffic.assumptions import Assumptions
from dynamics.traffic.occupancy import OtherVehicles
from dynamics.traffic.occupancy_kernels import least_next_position
from dynamics.traffic.rules_of_the_road import EgoFootprint, RoadRule, rule_violations
from shield import ShieldedEnv


class Sliding(Vehicle):
    """Moves along the road at its speed, and turns by `rate` [rad] a frame meanwhile."""

    rate = 0.0

    def act(self, action=None):
        pass

    def step(self, dt):
        self.position = self.position + np.array([self.speed * dt, 0.0])
        self.heading = min(self.heading + self.rate, math.pi)
        self.on_state_update()


def drive(hz, gap, rate, inputs):
    """Violations and whether the ego crashed, after the first verified decision behind a leader of the same speed."""
    config = {
        "simulation_frequency": hz,
        "policy_frequency": hz if inputs else 1,
        "lanes_count": 2,
        "vehicles_count": 1,
    }
    if inputs:
        config["action"] = {"type": "ContinuousAction"}
    env = ShieldedEnv(gym.make("highway-v0", config=config), "worst-case")
    env.reset(seed=0)
    base = env.unwrapped
    ego, road = base.vehicle, base.road
    road.vehicles = [ego]
    ego.position, ego.heading, ego.speed = np.array([300.0, 0.0]), 0.0, 30.0
    if not inputs:
        ego.target_lane_index, ego.speed_index, ego.target_speed = ("0", "1", 0), 2, 30.0
    ego.on_state_update()
    leader = Sliding(road, [300.0 + gap, 0.0], 0.0, 30.0)
    leader.rate = rate
    road.vehicles.append(leader)
    env.filter.reset()
    tiers = []
    for _ in range(4 * hz if inputs else 4):
        *_, done, _, info = env.step(np.zeros(2, np.float32) if inputs else 1)
        tiers.append(info["shield"]["tier"])
        if done:
            break
    return tiers[0], ego.crashed, info["shield"]["violations"]


@pytest.mark.parametrize("inputs", [False, True], ids=["meta-actions", "inputs"])
@pytest.mark.parametrize(("hz", "gap", "rate"), [(5, 10.2, math.pi), (10, 7.6, math.pi), (10, 7.6, 0.2)])
def test_a_vehicle_that_turns_round_before_the_ego_is_a_violator(hz, gap, rate, inputs):
    tier, crashed, violations = drive(hz, gap, rate, inputs)
    assert tier in ("passed", "governed")
    assert crashed
    assert violations > 0


@pytest.mark.parametrize("inputs", [False, True], ids=["meta-actions", "inputs"])
def test_a_vehicle_that_keeps_its_heading_is_no_violator(inputs):
    assert drive(10, 9.0, 0.0, inputs)[1:] == (False, 0)


ROAD, FAR = StraightRoad.from_lanes(3), EgoFootprint(1e6, 0.0, 0.0, 20.0, 4.5, 1.3, 2.5, 1.0, False)


def one(x, heading, speed, dt, before=None):
    row = np.array([[x, 4.0, heading, speed, 5.0, 2.0, 0.0]])
    return OtherVehicles(row, row[:, :4], ROAD, Assumptions.idm(), dt, before)


@settings(deadline=None)
@given(
    heading=st.floats(-math.pi, math.pi),
    speed=st.floats(-5.0, 40.0),
    lost=st.floats(0.0, 0.6),
    dt=st.sampled_from([1 / 5, 1 / 10, 1 / 15, 1 / 30]),
)
def test_the_predicted_place_of_the_coming_frame_is_that_of_the_bound(heading, speed, lost, dt):
    before = one(0.0, 0.0, speed, dt)
    now = one(speed * dt - min(lost, abs(speed) * dt), heading, speed, dt, before)
    place = least_next_position.py_func(0, now.states, now.stretch, now.motion, now.bodies)
    assert place == pytest.approx(now.rear(2)[0, 0] + now.reach[0], abs=1e-9)
    leads = now.states[0, 0] + speed * math.cos(heading) * dt
    grown = rule_violations(before, now, dt, np.zeros(1, bool), FAR).grown[0]
    if leads < place - 1e-6 and speed > 0:
        assert RoadRule.WAY in RoadRule(int(grown))
    if place <= leads <= now.states[0, 0] + max(speed, 0.0) * dt:
        assert RoadRule.WAY not in RoadRule(int(grown))
