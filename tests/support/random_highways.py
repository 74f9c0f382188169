"""Random highways for comparisons: configurations, and arranged scenes."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from highway_env.vehicle.objects import Obstacle
from simulator_pair import DRIVERS

from dynamics.highway_simulator.observe import FEATURES

__all__ = ["place", "random_configuration", "random_scene"]


def random_configuration(rng: np.random.Generator, most: int = 60) -> tuple[str, dict[str, Any]]:
    """An environment's id and a configuration of everything that a user sets, of at most so many vehicles."""

    def chance(p: float) -> bool:
        return bool(rng.random() < p)

    lanes, decisions = int(rng.integers(1, 9)), float(rng.choice([1, 2, 3, 5, 7, 0.5]))
    frames = rng.integers(2, 61) if chance(0.3) else rng.choice([5, 15, 2, 10])
    config: dict[str, Any] = {
        "lanes_count": lanes,
        "vehicles_count": min(most, int(rng.choice([0, 1, 2, 5, 10, 20, rng.integers(60)]))),
        "vehicles_density": float(rng.choice([1, 0.3, 2, 6, rng.uniform(0.3, 6)])),
        "ego_spacing": float(rng.choice([2, 1, 0.2, 5])),
        "initial_lane_id": None if chance(0.5) else int(rng.integers(lanes)),
        "policy_frequency": decisions if decisions < 1 else int(decisions),
        "simulation_frequency": int(max(frames, np.ceil(decisions))),
        "duration": float(rng.choice([3, 10, 40, 7.5])),
        "normalize_reward": chance(0.6),
        "offroad_terminal": chance(0.4),
        "other_vehicles_type": str(rng.choice(DRIVERS)),
    }
    for key in ("collision_reward", "right_lane_reward", "high_speed_reward", "on_road_reward"):
        if chance(0.5):
            config[key] = float(rng.choice([0, -1, 1, 0.1, rng.normal()])) if chance(0.8) else int(rng.integers(-2, 3))
    if chance(0.3):
        config["reward_speed_range"] = (
            [float(rng.uniform(0, 25)), float(rng.uniform(25, 40))] if chance(0.9) else [25, 25]
        )
    config["action"] = _random_action(rng)
    config["observation"] = _random_observation(rng)
    return "highway-fast-v0" if chance(0.5) else "highway-v0", config


def _random_action(rng: np.random.Generator) -> dict[str, Any]:
    part = rng.integers(4)
    parts = {"longitudinal": part != 1, "lateral": part != 2}
    if rng.random() < 0.5:
        speeds = [None, np.linspace(0, 40, int(rng.integers(2, 10))).astype(int).tolist(), [-5.0, 12.5, 13.0, 50.0]]
        return {"type": "DiscreteMetaAction", **parts, "target_speeds": speeds[rng.integers(3)]}
    action: dict[str, Any] = {"type": "ContinuousAction", **parts, "clip": bool(rng.random() < 0.7)}
    if rng.random() < 0.3:
        action["acceleration_range"] = [float(-rng.uniform(1, 30)), float(rng.uniform(1, 30))]
    if rng.random() < 0.3:
        action["steering_range"] = [float(-rng.uniform(0.01, 1.5)), float(rng.uniform(0.01, 1.5))]
    if rng.random() < 0.3:
        action["speed_range"] = [float(rng.uniform(-20, 5)), float(rng.uniform(10, 50))]
    return action


def _random_grid(rng: np.random.Generator) -> dict[str, Any]:
    names = ["presence", "x", "y", "vx", "vy", "heading", "cos_h", "sin_h", "long_off", "lat_off", "ang_off", "on_road"]
    grid: dict[str, Any] = {"type": "OccupancyGrid", "clip": bool(rng.integers(2))}
    grid["features"] = [str(name) for name in rng.permutation(names)[: rng.integers(1, len(names) + 1)]]
    half = rng.uniform(6, 60, size=2)
    grid["grid_size"] = [[-float(half[0]), float(half[0])], [-float(half[1]), float(half[1])]]
    grid["grid_step"] = rng.uniform(0.5, 6, size=2).tolist()
    if rng.integers(2):
        reach = rng.uniform(5, 200, size=3)
        grid["features_range"] = {name: [-float(r), float(r)] for name, r in zip(("x", "y", "vx"), reach, strict=True)}
    return grid


def _random_observation(rng: np.random.Generator) -> dict[str, Any]:
    if rng.random() < 0.15:
        return _random_grid(rng)
    observation: dict[str, Any] = {"type": "Kinematics", "order": str(rng.choice(["sorted", "sorted", "shuffled"]))}
    if rng.random() < 0.7:
        observation["features"] = [
            str(name) for name in rng.permutation(FEATURES)[: rng.integers(1, len(FEATURES) + 1)]
        ]
    if rng.random() < 0.7:
        observation["vehicles_count"] = int(rng.integers(2, 31))
    if rng.random() < 0.4:
        observation["features_range"] = {
            str(name): [float(rng.uniform(-100, 0)), float(rng.uniform(1, 100))]
            for name in rng.permutation(FEATURES)[: rng.integers(1, 8)]
        }
    for key in ("absolute", "normalize", "clip", "see_behind", "include_obstacles", "observe_intentions"):
        if rng.random() < 0.4:
            observation[key] = bool(rng.integers(2))
    return observation


def place(body: Any, x: float, y: float, speed: float = 0.0, heading: float = 0.0, aware: bool = True) -> None:
    """Put a body somewhere; unless `aware` it takes itself to be on the lane where it was."""
    body.position, body.speed, body.heading = np.array([x, y], dtype=float), speed, heading
    if aware:
        body.lane_index = body.road.network.get_closest_lane_index(body.position, heading)
        body.lane = body.road.network.get_lane(body.lane_index)
        if hasattr(body, "target_lane_index"):
            body.target_lane_index = body.lane_index


def random_scene(rng: np.random.Generator) -> gym.Env[Any, Any]:
    """A live environment with bodies placed anywhere: level, overlapping, off the road, backwards."""
    lanes, features = int(rng.integers(1, 5)), list(FEATURES)
    config = {
        "vehicles_count": int(rng.integers(1, 12)),
        "lanes_count": lanes,
        "duration": 1000,
        "simulation_frequency": int(rng.choice([5, 15, 8, 16, 4, 2])),
        "policy_frequency": int(rng.choice([1, 2])),
        "other_vehicles_type": str(rng.choice(DRIVERS)),
        "action": {"type": str(rng.choice(["DiscreteMetaAction", "ContinuousAction"]))},
        "observation": {
            "type": "Kinematics",
            "features": features,
            "vehicles_count": int(rng.integers(2, 12)),
            "see_behind": bool(rng.integers(2)),
            "normalize": bool(rng.integers(2)),
            "order": str(rng.choice(["sorted", "shuffled"])),
        },
    }
    env = gym.make(str(rng.choice(["highway-fast-v0", "highway-v0"])), config=config)
    env.reset(seed=int(rng.integers(1 << 30)))
    base: Any = env.unwrapped
    start, span = rng.choice([0.0, 100.0, -20.0, 9950.0]), rng.choice([20.0, 60.0, 200.0])
    for body in base.road.vehicles:
        if rng.random() < 0.85:
            x = start + (rng.uniform(-span, span) if rng.random() < 0.5 else float(rng.integers(-4, 5)) * 5)
            y = float(
                rng.choice([4.0 * rng.integers(lanes), 4.0 * rng.integers(lanes) + 2, rng.uniform(-6, 4 * lanes)])
            )
            heading = float(rng.choice([0, 0, 0, rng.uniform(-0.3, 0.3), rng.uniform(-10, 10), np.pi, -np.pi / 2]))
            speed = float(rng.choice([0, 20, 8, rng.uniform(-45, 50), rng.uniform(0, 30), 0.005, -0.005]))
            place(body, x, y, speed, heading, aware=bool(rng.random() < 0.7))
        _random_nature(rng, base, body, lanes)
    for _ in range(int(rng.choice([0, 0, 1, 3]))):
        at = [start + rng.uniform(-span, span), rng.uniform(-6, 4 * lanes + 2)]
        base.road.objects.append(Obstacle(base.road, at, heading=float(rng.choice([0, rng.uniform(-4, 4)]))))
    return env


def _random_nature(rng: np.random.Generator, base: Any, body: Any, lanes: int) -> None:
    """The target commands, crash flag and size of a body."""
    if hasattr(body, "target_lane_index") and rng.random() < 0.3:
        body.target_lane_index = ("0", "1", int(rng.integers(lanes)))
    if hasattr(body, "timer"):
        body.timer = float(rng.choice([body.timer, body.timer, 0, 5]))
        body.target_speed = float(rng.choice([body.target_speed, 0, 10, 50]))
        body.enable_lane_change = bool(rng.random() < 0.8)
        body.DELTA = float(rng.choice([body.DELTA, body.DELTA, 4, 2]))
    body.check_collisions = bool(body.check_collisions or rng.random() < 0.5)
    body.crashed = bool(rng.random() < 0.1)
    if rng.random() < 0.1:
        body.impact = rng.normal(size=2)
    if rng.random() < 0.2:
        body.LENGTH, body.WIDTH = float(rng.uniform(2, 14)), float(rng.uniform(1, 3))
    if rng.random() < 0.5:
        body.diagonal = np.sqrt(body.LENGTH**2 + body.WIDTH**2)
