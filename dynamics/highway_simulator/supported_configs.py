"""Check of a configuration for features that the compiled simulator does not support."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from highway_env import utils

from dynamics.errors import ConfigError
from dynamics.highway_simulator.grid import LAYERS
from dynamics.highway_simulator.kinds import kind_of
from dynamics.highway_simulator.observe import FEATURES

__all__ = ["unsupported_highway_settings"]

_MOST_LANES = 62
_IGNORED = frozenset(
    {
        "screen_width",
        "screen_height",
        "centering_position",
        "scaling",
        "show_trajectories",
        "render_agent",
        "offscreen_rendering",
        "real_time_rendering",
        "neighbour_vehicles_connected_lanes",
        "lane_change_reward",
    }
)
"""Keys without effect here: rendering, connected lanes on a road that does not end, and a reward that highway-env never
reads."""
_READ = frozenset(
    {
        "observation",
        "action",
        "simulation_frequency",
        "policy_frequency",
        "other_vehicles_type",
        "lanes_count",
        "vehicles_count",
        "controlled_vehicles",
        "initial_lane_id",
        "duration",
        "ego_spacing",
        "vehicles_density",
        "collision_reward",
        "right_lane_reward",
        "high_speed_reward",
        "on_road_reward",
        "reward_speed_range",
        "normalize_reward",
        "offroad_terminal",
        "manual_control",
    }
)


def unsupported_highway_settings(config: Mapping[str, Any]) -> list[str]:
    """All unsupported entries of a whole configuration; an empty list if it is supported."""
    return [*_scene(config), *_observation(config), *_action(config)]


def _number(value: Any, least: float = -math.inf, whole: bool = False) -> bool:
    """Whether a value is a finite number, at least `least`, and an integer if `whole`."""
    kinds = (int, np.integer) if whole else (int, float, np.integer, np.floating)
    return isinstance(value, kinds) and math.isfinite(value) and bool(value >= least)


def _scene(config: Mapping[str, Any]) -> list[str]:
    """The unsupported entries outside of observation and action."""
    refused = [f"{key}={config[key]!r}" for key in sorted(config.keys() - _READ - _IGNORED)]
    if config["controlled_vehicles"] != 1:
        refused.append(f"controlled_vehicles={config['controlled_vehicles']}")
    if config["manual_control"]:
        refused.append("manual_control")
    whole = {"lanes_count": 1, "vehicles_count": 0}
    positive = ("simulation_frequency", "policy_frequency", "vehicles_density")
    numbers = ("collision_reward", "right_lane_reward", "high_speed_reward", "duration", "ego_spacing")
    bad = [key for key, least in whole.items() if not _number(config[key], least, whole=True)]
    bad += [key for key in positive if not (_number(config[key]) and config[key] > 0)]
    bad += [key for key in numbers if not _number(config[key])]
    speeds = config["reward_speed_range"]
    if not (isinstance(speeds, list | tuple | np.ndarray) and len(speeds) >= 2 and all(map(_number, speeds))):
        bad.append("reward_speed_range")
    refused += [f"{key}={config[key]!r}" for key in bad]
    if not bad:
        n, first = config["lanes_count"], config["initial_lane_id"]
        if n > _MOST_LANES:
            refused.append(f"lanes_count={n}")
        if first is not None and not (_number(first, -n, whole=True) and first < n):
            refused.append(f"initial_lane_id={first}")
        if config["simulation_frequency"] < config["policy_frequency"]:
            refused.append("fewer frames than decisions")
    try:
        kind_of(utils.class_from_path(config["other_vehicles_type"]))
    except (ConfigError, AttributeError, ImportError, ValueError) as error:
        refused.append(f"other_vehicles_type={config['other_vehicles_type']} ({error})")
    return refused


def _observation(config: Mapping[str, Any]) -> list[str]:
    """The unsupported parts of the observation."""
    observation = config["observation"]
    kind = observation.get("type") if isinstance(observation, Mapping) else None
    if kind not in ("Kinematics", "OccupancyGrid"):
        return [f"observation {kind}"]
    refused, features = [], observation.get("features") or ()
    known = {*FEATURES, *(LAYERS if kind == "OccupancyGrid" else ())}
    if isinstance(features, str) or len(set(features)) != len(features) or set(features) - known:
        refused.append(f"features {features}")
    if kind == "OccupancyGrid":
        odd = [key for key in ("absolute", "align_to_vehicle_axes", "as_image") if observation.get(key)]
        return [*refused, *(f"a grid that is {key}" for key in odd)]
    if observation.get("order", "sorted") not in ("sorted", "shuffled"):
        refused.append(f"observations in order {observation['order']!r}")
    if not _number(observation.get("vehicles_count", 5), 2, whole=True):
        refused.append(f"observations of {observation['vehicles_count']} vehicles")
    return refused


def _action(config: Mapping[str, Any]) -> list[str]:
    """The unsupported parts of the action."""
    action = config["action"]
    kind = action.get("type") if isinstance(action, Mapping) else None
    if kind not in ("DiscreteMetaAction", "ContinuousAction"):
        return [f"action {kind}"]
    if action.get("dynamical"):
        return ["dynamical actions"]
    if not action.get("longitudinal", True) and not action.get("lateral", True):
        return ["neither longitudinal nor lateral actions"]
    speeds = action.get("target_speeds")
    if speeds is not None and (len(speeds) < 2 or not all(map(_number, speeds)) or speeds[0] == speeds[-1]):
        return [f"target_speeds {speeds}"]
    return []
