"""What is handed in as an environment: the highway-env environments inside, or an error that says what is valid."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
from highway_env.envs.common.action import ContinuousAction

from dynamics.scenes.scene import has_road_and_vehicles
from shield.errors import ConfigError

__all__ = ["base_environments", "the_action_type"]

_META, _INPUTS = "DiscreteMetaAction", "ContinuousAction"


def base_environments(env: Any, door: str) -> list[Any]:
    """The highway-env environments inside a Gymnasium environment or a VecEnv of one process, innermost.

    Raises
    ------
    ConfigError
        If it is none, keeps its environments in other processes, is shielded already, has fewer frames than decisions,
        or a wrapper of it changes the actions.
    """
    if not hasattr(env, "unwrapped") and not hasattr(env, "num_envs"):
        raise ConfigError(
            f"{door} takes a Gymnasium environment or a VecEnv, got {type(env).__name__}; settings go to config="
        )
    each = [env]
    if hasattr(env, "num_envs"):
        each = getattr(env, "envs", None) or []
        if not each:
            raise ConfigError(
                f"{type(env).__name__} keeps its environments in other processes, where {door} cannot read "
                "the scene; put the shield inside, SubprocVecEnv([lambda: ShieldedEnv(gym.make(...))]), or read "
                'observations alone: Shield(..., frames=False, perception="observation")'
            )
    for one in each:
        _refuse_shielded(one, door)
        _refuse_changed_actions(one, door)
    bases = [one.unwrapped for one in each]
    for base in bases:
        if not has_road_and_vehicles(base):
            raise ConfigError(
                f"{type(base).__name__} is not a highway-env environment: it has no road and vehicles. {door} is for "
                "highways, racetracks, merges, exits, roundabouts, two-way roads, u-turns, intersections, lane keeping "
                "and parking lots, and for environments made as these are"
            )
        frames, decisions = (base.config.get(f"{name}_frequency", 1) for name in ("simulation", "policy"))
        if frames < decisions:
            raise ConfigError(
                f"there are fewer frames (simulation_frequency {frames}) than decisions (policy_frequency {decisions})"
            )
    return bases


def _refuse_changed_actions(env: Any, door: str) -> None:
    """Raise where something inside changes the actions: what is executed would not be what was verified.

    Raises
    ------
    ConfigError
        If one of the wrappers is an `ActionWrapper`.
    """
    for one in _layers(env):
        if isinstance(one, gym.ActionWrapper):
            kind = type(one).__name__
            raise ConfigError(
                f"{kind} changes the actions, and what was verified would not be what is executed; {door} takes the "
                f"environment without it. Put it around a ShieldedEnv: {kind}(ShieldedEnv(gym.make(...)), ...)"
            )


def _refuse_shielded(env: Any, door: str) -> None:
    """Raise where there is a shield inside already.

    Raises
    ------
    ConfigError
        If one of the wrappers is a `ShieldedEnv`.
    """
    if any(type(one).__name__ == "ShieldedEnv" for one in _layers(env)):
        raise ConfigError(f"this environment is a ShieldedEnv already: {door} around it would filter what was filtered")


def the_action_type(bases: list[Any], door: str) -> str:
    """What the policy decides about: "DiscreteMetaAction", or "ContinuousAction", of which `DiscreteAction` is a kind.

    Raises
    ------
    ConfigError
        If it is neither, or not the same in all environments.
    """
    kinds = {type(getattr(base, "action_type", None)) for base in bases}
    if len(kinds) == 1:
        (kind,) = kinds
        if issubclass(kind, ContinuousAction):
            return _INPUTS
        if kind.__name__ == _META:
            return _META
    names = ", ".join(sorted(kind.__name__ for kind in kinds))
    if names == "MultiAgentAction":
        raise ConfigError(f"{door} filters one ego's actions; ShieldedEnv(env, ShieldConfig.exact()) those of several")
    raise ConfigError(
        f"{door} filters {_META}, {_INPUTS} or DiscreteAction; this environment has {names}. "
        f'Pass config={{"action": {{"type": "{_META}"}}}} to gym.make'
    )


def _layers(env: Any) -> Iterator[Any]:
    while env is not None:
        yield env
        env = env.__dict__.get("env")
