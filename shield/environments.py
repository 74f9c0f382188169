"""What is handed in as an environment: the highway-env environments inside, or an error that says what is valid."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from dynamics.scenes.parking_lot import is_lot
from dynamics.scenes.scene import has_road_and_vehicles
from shield.config import ShieldConfig
from shield.errors import ConfigError, ShieldError
from shield.perception.known import Known
from shield.supported_environments import check_frequency, check_perception, check_target_speeds, refuse_manual_control

__all__ = [
    "base_environments",
    "check_configuration",
    "check_gone_on",
    "check_step",
    "frames_of",
    "is_known",
    "refuse_lots",
]


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
            alone = 'observations alone: Shield(..., frames=False, perception="observation")'
            raise ConfigError(
                f"{type(env).__name__} keeps its environments in other processes, where {door} cannot read "
                "the scene; put the shield inside, SubprocVecEnv([lambda: ShieldedEnv(gym.make(...))])"
                f"{f', or read {alone}' if is_known(env) else ''}"
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


def is_known(env: Any) -> bool:
    """Whether what is needed to read observations alone is known of the environments in other processes."""
    try:
        Known.of(env)
    except ShieldError:
        return False
    return True


def check_configuration(base: Any, config: ShieldConfig) -> None:
    """Raise where an environment is configured as no verification holds for: at construction, and after each reset.

    Parameters
    ----------
    base : highway-env's environment, unwrapped, or a compiled one.
    config : settings of the shield; with mode "none" nothing is verified, and neither speeds nor frames are checked.

    Raises
    ------
    ConfigError
        If decisions do not reach the ego, its meta-actions can make it drive backwards or faster than it can brake from
        within the perception range, or there are fewer frames a second than verification has been tested with.
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
    """Raise where a step was not the one decision that was verified.

    Parameters
    ----------
    base : highway-env's environment, unwrapped, after the step. before : its `steps` before.
    executed : the action that was handed to the environment. info : what the step returned.

    Raises
    ------
    ConfigError
        If the ego got another action or none, or if there were more frames than a decision has, or none.
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


def check_gone_on(base: Any, before: int) -> None:
    """Raise where more than one decision was carried out since a policy was asked last: the others were not verified.

    Parameters
    ----------
    base : highway-env's environment, unwrapped, in the same episode. before : its `steps` then.

    Raises
    ------
    ConfigError
        If there were more frames than a decision has, or the actions do not reach the ego.
    """
    refuse_manual_control(base.config)
    frames, went = frames_of(base), int(base.steps) - before
    _refuse_late_actions(before, frames)
    if went > frames:
        raise ConfigError(
            f"the environment went on by {went} frames since the last predict(), and a decision has {frames}: its "
            "actions are repeated, or taken without the shield. Ask predict() before each step, and put a wrapper that "
            "repeats actions around a ShieldedEnv"
        )


def _refuse_late_actions(before: int, frames: int) -> None:
    """Raise where highway-env carries an action out later than it was taken: at frames that `frames` divides only."""
    if before % frames:
        raise ConfigError(
            f"the frequencies were changed within an episode: the decision began at frame {before}, and highway-env "
            f"takes actions at every {frames}. frame only; call reset() after the change"
        )


def frames_of(base: Any) -> int:
    """Simulation frames of one decision."""
    return int(base.config["simulation_frequency"] // base.config["policy_frequency"])


def _same(given: Any, executed: Any) -> bool:
    """Whether two actions are equal; True where they cannot be compared as numbers."""
    try:
        return np.array_equal(np.asarray(given, float), np.asarray(executed, float), equal_nan=True)
    except (TypeError, ValueError):
        return True


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


def refuse_lots(bases: list[Any]) -> None:
    """Raise where meta-actions are to be filtered in a parking lot: they steer to lanes, and there are none.

    Raises
    ------
    ConfigError
        If one of the environments is a parking lot.
    """
    for base in bases:
        if is_lot(base):
            raise ConfigError(
                f"{type(base).__name__} with {type(base.action_type).__name__}: in a parking lot the shield filters "
                'ContinuousAction only. Pass config={"action": {"type": "ContinuousAction"}} to gym.make, and no '
                "ShieldConfig.simulated_traffic(): nothing is simulated there"
            )


def _layers(env: Any) -> Iterator[Any]:
    while env is not None:
        yield env
        env = env.__dict__.get("env")
