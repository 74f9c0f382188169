"""Check of a configuration for features that the compiled episodes do not support."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from highway_env import utils
from highway_env.envs import exit_env, intersection_env, merge_env, roundabout_env, two_way_env, u_turn_env
from highway_env.vehicle.behavior import IDMVehicle

from dynamics.errors import ConfigError
from dynamics.highway_simulator.kinds import kind_of, mix_of
from dynamics.highway_simulator.observe import FEATURES
from dynamics.road_networks.episodes.rewards import CROSSING, EXITING, MERGING, NAMES, ROUND, TURNING, TWO_WAY

__all__ = ["environment_kind", "is_supported_environment", "supported_environment_names", "unsupported_road_settings"]

_WORLDS: dict[type, int] = {
    merge_env.MergeEnv: MERGING,
    merge_env.ConnectedLaneMergeEnv: MERGING,
    merge_env.MergeGenericEnv: MERGING,
    merge_env.ConnectedLaneMergeGenericEnv: MERGING,
    roundabout_env.RoundaboutEnv: ROUND,
    roundabout_env.ConnectedLaneRoundaboutEnv: ROUND,
    roundabout_env.RoundaboutGenericEnv: ROUND,
    roundabout_env.ConnectedLaneRoundaboutGenericEnv: ROUND,
    exit_env.ExitEnv: EXITING,
    exit_env.ConnectedLaneExitEnv: EXITING,
    two_way_env.TwoWayEnv: TWO_WAY,
    u_turn_env.UTurnEnv: TURNING,
    u_turn_env.ConnectedLaneUTurnEnv: TURNING,
    intersection_env.IntersectionEnv: CROSSING,
    intersection_env.ConnectedLaneIntersectionEnv: CROSSING,
    intersection_env.ContinuousIntersectionEnv: CROSSING,
}
_READ_ELSEWHERE = ("reward_speed_range",)
"""Keys that are read on some roads, and have no effect on others, in highway-env as here."""
_VIEWS = ("Kinematics", "ExitObservation", "TimeToCollision")


def supported_environment_names() -> str:
    """The names of the supported environment classes."""
    return ", ".join(kind.__name__ for kind in _WORLDS)


def is_supported_environment(kind: object) -> bool:
    """Whether an object is an environment class with compiled episodes."""
    return isinstance(kind, type) and kind in _WORLDS


def environment_kind(kind: type) -> int:
    """MERGING to CROSSING, for an environment class.

    Raises
    ------
    ConfigError
        If the class is not supported.
    """
    if kind not in _WORLDS:
        raise ConfigError(
            f"the episodes of {kind.__name__} are not compiled; those of {supported_environment_names()} are"
        )
    return _WORLDS[kind]


def unsupported_road_settings(kind: type[Any], config: Mapping[str, Any]) -> list[str]:
    """All unsupported entries of a whole configuration; an empty list if it is supported."""
    known = {*kind.default_config(), *NAMES[environment_kind(kind)], *_READ_ELSEWHERE}
    refused = [f"{key}={config[key]!r}" for key in sorted(config.keys() - known)]
    if config.get("controlled_vehicles", 1) != 1:
        refused.append(f"controlled_vehicles={config['controlled_vehicles']}")
    refused += [key for key in ("show_trajectories", "manual_control") if config[key]]
    if environment_kind(kind) == CROSSING and not math.isfinite(config["duration"]):
        refused.append(f"duration={config['duration']}")
    try:
        traffic = utils.class_from_path(config["other_vehicles_type"])
        kind_of(traffic)
        if len(mix_of(traffic)) > 1 or not issubclass(traffic, IDMVehicle):
            refused.append(f"other_vehicles_type={traffic.__name__}")
    except (ConfigError, AttributeError, ImportError, ValueError) as error:
        refused.append(f"other_vehicles_type={config['other_vehicles_type']} ({error})")
    if config["observation"].get("type") == "ExitObservation" and environment_kind(kind) != EXITING:
        refused.append("an ExitObservation where there is no exit")
    return [*refused, *_observation(config), *_action(config)]


def _observation(config: Mapping[str, Any]) -> list[str]:
    """The unsupported parts of the observation."""
    observation = config["observation"]
    kind = observation.get("type") if isinstance(observation, Mapping) else None
    if kind not in _VIEWS:
        return [f"observation {kind}"]
    if kind == "TimeToCollision":
        inputs = config["action"].get("type") != "DiscreteMetaAction"
        return ["TimeToCollision without meta-actions"] if inputs else []
    refused, features = [], observation.get("features") or ()
    if isinstance(features, str) or len(set(features)) != len(features) or set(features) - set(FEATURES):
        refused.append(f"features {features}")
    if observation.get("order", "sorted") not in ("sorted", "shuffled"):
        refused.append(f"observations in order {observation['order']!r}")
    count = observation.get("vehicles_count", 5)
    if not isinstance(count, int | np.integer) or count < 2:
        refused.append(f"observations of {count} vehicles")
    return refused


def _action(config: Mapping[str, Any]) -> list[str]:
    """The unsupported parts of the action."""
    action = config["action"]
    kind = action.get("type") if isinstance(action, Mapping) else None
    if kind not in ("DiscreteMetaAction", "ContinuousAction"):
        return [f"action {kind}"]
    speeds = action.get("target_speeds")
    if speeds is not None and (len(speeds) < 2 or len(set(speeds)) != len(speeds) or speeds[0] == speeds[-1]):
        return [f"target_speeds {speeds}"]
    return []
