"""Traffic of intersections with parameters of its own.

highway-env's `IntersectionEnv` sets `DISTANCE_WANTED`, `COMFORT_ACC_MAX` and `COMFORT_ACC_MIN` on the class of its
traffic, at each reset and at construction. From then on vehicles of that class drive differently in every other
environment of the process. With the classes of this module, no other environment is changed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec, load_env_creator
from highway_env.envs.intersection_env import IntersectionEnv
from highway_env.vehicle import behavior

from dynamics.scenes.registration import spec_of
from dynamics.vehicle.action_grid import KEPT, has_grid, put_on_grid

__all__ = ["AggressiveVehicle", "DefensiveVehicle", "IDMVehicle", "LinearVehicle", "make", "with_own_traffic"]

_KEY, _STOCK = "other_vehicles_type", behavior.__name__


class IDMVehicle(behavior.IDMVehicle):  # type: ignore[misc]
    """highway-env's `IDMVehicle`, for intersections."""


class LinearVehicle(behavior.LinearVehicle):  # type: ignore[misc]
    """highway-env's `LinearVehicle`, for intersections."""


class AggressiveVehicle(behavior.AggressiveVehicle):  # type: ignore[misc]
    """highway-env's `AggressiveVehicle`, for intersections."""


class DefensiveVehicle(behavior.DefensiveVehicle):  # type: ignore[misc]
    """highway-env's `DefensiveVehicle`, for intersections."""


def with_own_traffic(env_id: str, config: Mapping[str, Any]) -> dict[str, Any]:
    """A copy of a configuration. At an intersection, a traffic class of highway-env is replaced by the class of the
    same name in this module."""
    spec = gym.registry.get(env_id.rpartition(":")[2])
    return dict(config) if spec is None else _with_own_traffic(spec, config)


def _with_own_traffic(spec: EnvSpec, config: Mapping[str, Any]) -> dict[str, Any]:
    """`with_own_traffic` for a registered environment."""
    kind, given = _kind(spec), dict(config)
    if not (isinstance(kind, type) and issubclass(kind, IntersectionEnv)):
        return given
    default = cast(Any, kind).default_config()[_KEY]
    module, _, name = str(given.get(_KEY, default)).rpartition(".")
    return {**given, _KEY: f"{__name__}.{name}"} if module == _STOCK and name in __all__ else given


def make(env_id: str, config: Mapping[str, Any], **options: Any) -> gym.Env[Any, Any]:
    """`gym.make` with the configuration of `with_own_traffic`, without Gymnasium's warning if a later version is
    registered.

    As in `gym.make`, `config` replaces the configuration that the id is registered with
    (`dynamics.scenes.registration.registered_config`). An empty configuration is not passed on, as the entry point may
    take none. A `DiscreteAction` with two `actions_per_axis` is a grid of throttle and steering
    (`dynamics.vehicle.action_grid`), which highway-env itself does not have.
    """
    spec = spec_of(env_id)
    whole = _with_own_traffic(spec, config)
    if has_grid(whole) and not _makes_grids(spec):
        return _on_grid(spec, whole, options)
    if whole:
        options["config"] = whole
    return gym.make(spec, **options)


def _on_grid(spec: EnvSpec, config: dict[str, Any], options: dict[str, Any]) -> gym.Env[Any, Any]:
    """Make an environment with `ContinuousAction`, and put it on the grid of its configuration."""
    own = cast(Any, _kind(spec)).default_config().get("action", {})
    action = {**{key: value for key, value in own.items() if key in KEPT}, **config["action"]}
    rest = {key: value for key, value in action.items() if key not in ("type", "actions_per_axis")}
    env = gym.make(spec, **options, config={**config, "action": {**rest, "type": "ContinuousAction"}})
    put_on_grid(env.unwrapped, action)
    return env


def _makes_grids(spec: EnvSpec) -> bool:
    """Whether an environment class supports grids of actions itself: it has `makes_grids`, or the entry point is a
    function."""
    kind = _kind(spec)
    return not isinstance(kind, type) or bool(getattr(kind, "makes_grids", False))


def _kind(spec: EnvSpec) -> Any:
    """The class or function that makes an environment."""
    entry = spec.entry_point
    return load_env_creator(entry) if isinstance(entry, str) else entry
