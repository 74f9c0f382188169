"""Throttle and steering on any road, frame by frame in highway-env and in its compiled copy."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
from network_pair import Pair
from simulator_pair import same_numbers

from dynamics.highway_simulator.layout import TARGET_SPEED, TIMER
from dynamics.road_networks.geometry.layout import LATERAL_SPEED, YAW_RATE
from evaluation.measuring.rectangles import separation
from evaluation.wrappers import ThrottleAndSteering
from evaluation.wrappers.throttle_and_steering import ROADS

__all__ = ["InputPair", "gap", "make_inputs", "push"]


def make_inputs(env_id, **action):
    """The environment with `ContinuousAction`."""
    if env_id in ROADS:
        return ThrottleAndSteering(gym.make(env_id), **action)
    return gym.make(env_id, config={"action": {"type": "ContinuousAction", **action}})


class InputPair(Pair):
    """A live environment with throttle and steering, and its compiled copy."""

    def __init__(self, env_id, seed, dynamical=False):
        self.env = make_inputs(env_id, dynamical=dynamical).unwrapped
        self.env.reset(seed=seed)
        self.name = f"{env_id} seed {seed}, dynamical {dynamical}"
        self.start()

    def frames(self, action, frames):
        """So many frames of both, compared."""
        env, low = self.env, self.env.action_type.get_action(action)
        env.action_type.act(action)
        rows = self.simulator.hold(low["acceleration"], low["steering"], frames)
        for _ in range(frames):
            env.road.act()
            env.road.step(1 / env.config["simulation_frequency"])
            env.steps += 1
        self.compare_all(rows[-1])

    def compare_all(self, rows):
        """All vehicles that are still on the road."""
        f, _ = self.compare_bodies(rows)
        road, exact = self.env.road, self.simulator.exact
        others = [k for k, v in enumerate(road.vehicles) if v is not self.env.vehicle]
        drivers = [road.vehicles[k] for k in others]
        assert same_numbers([float(v.target_speed) for v in drivers], f[TARGET_SPEED, others], exact), self.name
        assert same_numbers([float(v.timer) for v in drivers], f[TIMER, others], exact), self.name
        if hasattr(self.env.vehicle, "yaw_rate"):
            ego = road.vehicles.index(self.env.vehicle)
            state = [self.env.vehicle.lateral_speed, self.env.vehicle.yaw_rate]
            assert same_numbers(np.array(state, float), f[[LATERAL_SPEED, YAW_RATE], ego], exact), self.name


def push(env, inputs):
    """A frame of highway-env with the ego's low-level action as it is given, acceleration [m/s^2] and wheel [rad]."""
    env.vehicle.act({"acceleration": float(inputs[0]), "steering": float(inputs[1])})
    env.road.act()
    env.road.step(1 / env.config["simulation_frequency"])
    env.steps += 1


def gap(env, buffer, ego=None):
    """The distance between an ego with its buffer and the nearest body [m]; by default of the first."""
    ego = env.vehicle if ego is None else ego
    wide = [ego.LENGTH + 2 * buffer.longitudinal, ego.WIDTH + 2 * buffer.lateral]
    mine = np.array([*ego.position, ego.heading, 0.0, *wide])
    others = [*(v for v in env.road.vehicles if v is not ego), *env.road.objects]
    rows = [np.array([*v.position, v.heading, 0.0, v.LENGTH, v.WIDTH]) for v in others]
    return min((float(separation(mine, row)) for row in rows), default=np.inf)
