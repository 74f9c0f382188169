"""The highway-env environments inside a user's environment, and errors that list the valid ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from dynamics.scenes.parking_lot import is_parking_lot
from dynamics.scenes.scene import has_road_and_vehicles
from shield.config import ShieldConfig
from shield.errors import ConfigError, ShieldError
from shield.perception.known import Known
from shield.supported_environments import check_frequency, check_perception, check_target_speeds, refuse_manual_control

__all__ = [
    "base_environments",
    "check_configuration",
    "check_single_decision",
    "check_step",
    "frames_of",
    "is_known",
    "refuse_parking_lots",
]


def base_environments(env: Any, wrapper: str) -> list[Any]:
    """The highway-env environments inside a Gymnasium environment or a VecEnv of one process, innermost.

    Raises
    ------
    ConfigError
        If it is not such an environment, keeps its environments in other processes, is shielded already, or has fewer
        frames than decisions. If one of its wrappers changes the actions.
    """
    if not hasattr(env, "unwrapped") and not hasattr(env, "num_envs"):
        raise ConfigError(
            f"{wrapper} takes a Gymnasium environment or a VecEnv, got {type(env).__name__}; settings go to config="
        )
    each = [env]
    if hasattr(env, "num_envs"):
        each = getattr(env, "envs", None) or []
        if not each:
            alone = 'observations alone: Shield(..., frames=False, perception="observation")'
            raise ConfigError(
                f"{type(env).__name__} keeps its environments in other processes, where {wrapper} cannot read "
                "the scene; put the shield inside, SubprocVecEnv([lambda: ShieldedEnv(gym.make(...))])"
                f"{f', or read {alone}' if is_known(env) else ''}"
            )
    for one in each:
        _refuse_shielded(one, wrapper)
        _refuse_changed_actions(one, wrapper)
    bases = [one.unwrapped for one in each]
    for base in bases:
        if not has_road_and_vehicles(base):
            raise ConfigError(
                f"{type(base).__name__} is not a highway-env environment: it has no road and vehicles. {wrapper} is "
                "for highways, racetracks, merges, exits, roundabouts, two-way roads, u-turns, intersections, lane "
                "keeping and parking lots, and for environments made as these are"
            )
        frames, decisions = (base.config.get(f"{name}_frequency", 1) for name in ("simulation", "policy"))
        if frames < decisions:
            raise ConfigError(
                f"there are fewer frames (simulation_frequency {frames}) than decisions (policy_frequency {decisions})"
            )
    return bases


def is_known(env: Any) -> bool:
    """Whether the prior map of the environments in other processes is available, for observations alone."""
    try:
        Known.of(env)
    except ShieldError:
        return False
    return True


def check_configuration(base: Any, config: ShieldConfig) -> None:
    """Check that verification holds for an environment's configuration: at construction, and after each reset.

    Parameters
    ----------
    base : highway-env's environment, unwrapped, or a compiled one.
    config : settings of the shield. With mode "none" nothing is verified, and neither speeds nor frames are checked.

    Raises
    ------
    ConfigError
        If actions do not reach the ego. If meta-actions can make it drive backwards, or faster than it can brake from
        within the perception range. If there are fewer frames a second than verification has been tested with.
    """
    refuse_manual_control(base.config)
    if config.mode == "none":
        return
    if config.mode == "full":
        check_frequency(base.config["simulation_frequency"], config.simulates)
    kinds = getattr(base.action_type, "agents_action_types", [base.action_type])
    for each in (*kinds, *base.controlled_vehicles):
        speeds = getattr(each, "target_speeds", None)
        if speeds is not None:
            check_target_speeds(speeds)
            check_perception(speeds, config)


def check_step(base: Any, before: int, executed: Any, info: Mapping[str, Any]) -> None:
    """Check that a step executed exactly the verified decision.

    Parameters
    ----------
    base : highway-env's environment, unwrapped, after the step. before : its `steps` before.
    executed : the action that was passed to the environment. info : from the step.

    Raises
    ------
    ConfigError
        If the ego got another action or none, or if there were more frames than in a decision, or none.
    """
    refuse_manual_control(base.config)
    given = info.get("action", executed)
    if not _same(given, executed):
        raise ConfigError(
            f"the environment was given action {given} and not {executed}, which was verified: a wrapper inside "
            "changes it; put that around the ShieldedEnv"
        )
    frames, went = frames_of(base), int(base.steps) - before
    _refuse_late_actions(before, frames)
    if not 0 < went <= frames:
        raise ConfigError(
            f"the environment went on by {went} frames in one step, and a decision has {frames}: a wrapper inside "
            "repeats the action or resets the environment; put that wrapper around the ShieldedEnv"
        )


def check_single_decision(base: Any, before: int) -> None:
    """Check that at most one decision was executed since the last call of the policy: others would be unverified.

    Parameters
    ----------
    base : highway-env's environment, unwrapped, in the same episode. before : its `steps` at that call.

    Raises
    ------
    ConfigError
        If there were more frames than in a decision, or the actions do not reach the ego.
    """
    refuse_manual_control(base.config)
    frames, went = frames_of(base), int(base.steps) - before
    _refuse_late_actions(before, frames)
    if went > frames:
        raise ConfigError(
            f"the environment went on by {went} frames since the last predict(), and a decision has {frames}: its "
            "actions are repeated, or taken without the shield. Call predict() before each step, and put a wrapper "
            "that repeats actions around a ShieldedEnv"
        )


def _refuse_late_actions(before: int, frames: int) -> None:
    """Raise if highway-env executes an action later than it was chosen, which is at multiples of `frames` only."""
    if before % frames:
        raise ConfigError(
            f"the frequencies were changed within an episode: the decision began at frame {before}, and highway-env "
            f"takes actions at every {frames}. frame only; call reset() after the change"
        )


def frames_of(base: Any) -> int:
    """Simulation frames of one decision."""
    return int(base.config["simulation_frequency"] // base.config["policy_frequency"])


def _same(given: Any, executed: Any) -> bool:
    """Whether two actions are equal; True if they cannot be compared as numbers."""
    try:
        return np.array_equal(np.asarray(given, float), np.asarray(executed, float), equal_nan=True)
    except (TypeError, ValueError):
        return True


def _refuse_changed_actions(env: Any, wrapper: str) -> None:
    """Check that no wrapper changes the actions, which would invalidate the verification.

    Raises
    ------
    ConfigError
        If one of the wrappers is an `ActionWrapper`.
    """
    for one in _layers(env):
        if isinstance(one, gym.ActionWrapper):
            kind = type(one).__name__
            raise ConfigError(
                f"{kind} changes the actions, and what was verified would not be what is executed; {wrapper} takes the "
                f"environment without it. Put it around a ShieldedEnv: {kind}(ShieldedEnv(gym.make(...)), ...)"
            )


def _refuse_shielded(env: Any, wrapper: str) -> None:
    """Check that there is no shield inside.

    Raises
    ------
    ConfigError
        If one of the wrappers is a `ShieldedEnv`.
    """
    if any(type(one).__name__ == "ShieldedEnv" for one in _layers(env)):
        raise ConfigError(
            f"this environment is a ShieldedEnv already: {wrapper} around it would filter what was filtered"
        )


def refuse_parking_lots(bases: list[Any]) -> None:
    """Check that meta-actions are not filtered in a parking lot, which has no lanes to steer to.

    Raises
    ------
    ConfigError
        If one of the environments is a parking lot.
    """
    for base in bases:
        if is_parking_lot(base):
            raise ConfigError(
                f"{type(base).__name__} with {type(base.action_type).__name__}: in a parking lot the shield filters "
                'ContinuousAction only. Pass config={"action": {"type": "ContinuousAction"}} to gym.make, and no '
                "ShieldConfig.simulated_traffic(): nothing is simulated there"
            )


def _layers(env: Any) -> Iterator[Any]:
    """The wrappers of an environment, outermost first, and the environment itself."""
    while env is not None:
        yield env
        env = env.__dict__.get("env")
