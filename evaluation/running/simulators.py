"""Choice of the simulator: highway-env, or its compiled copy where supported.

On road networks the compiled variant is highway-env itself with compiled frames.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
from highway_env.envs.common.action import ContinuousAction

from dynamics.highway_simulator.env import CompiledHighwayEnv
from dynamics.road_networks.simulation.supported_traffic import on_network
from evaluation.policies import list_references
from evaluation.running.records import ShieldVariant, variant_for
from evaluation.settings import Setting
from evaluation.simulators import compiled_if_supported, with_compiled_frames
from evaluation.wrappers.channels import seen_through, split_sensor
from shield.errors import ConfigError

__all__ = ["environment"]

_READY = (
    *("faster", "idle", "slower", "throttle", "random", "weaving", "left", "right"),
    *("lookahead", "lookahead-shielded"),
)
"""Baselines that read only the observation, as models do, or support the compiled copy. The others read highway-env's
objects."""


def environment(
    setting: Setting, policy: Any, variant: ShieldVariant, model: str | None, simulator: str, sensor: str = "exact"
) -> tuple[str, gym.Env[Any, Any]]:
    """Make the environment of a setting.

    Parameters
    ----------
    setting, policy, variant, model : specification of the episode (see `evaluation.running.episodes.run_episode`).
    simulator : one of `SIMULATORS`; "auto" for the compiled copy where supported, which is equal to the last bit.
    sensor : sensor of the policy, and of a shield that reads observations, as in
        `evaluation.wrappers.channels.split_sensor`. On road networks every sensor but "exact" needs highway-env itself.

    Returns
    -------
    The name of the simulator, and the environment.

    Raises
    ------
    ConfigError
        If the simulator is unknown, or "compiled" is required and not supported.
    PlatformError
        If "compiled" is required, and numpy's own loops are not accessible on this machine.
    """

    split_sensor(sensor)

    def compiled() -> tuple[gym.Env[Any, Any], bool]:
        made = setting.make()
        if on_network(made.unwrapped):
            if sensor != "exact":
                raise ConfigError(f"the sensor {sensor!r} observes highway-env itself on this road")
            return _with_compiled_frames(made, variant)
        _check(policy, variant, model)
        env = CompiledHighwayEnv(setting.env_id, setting.configured)
        if variant.placement != "none" and variant.config.simulates and isinstance(env.action_type, ContinuousAction):
            raise ConfigError("throttle and steering are verified by simulation in highway-env itself")
        return seen_through(env, sensor), env.simulator.exact

    env = compiled_if_supported(simulator, compiled)
    if env is not None:
        return "compiled", env
    return "highway-env", seen_through(setting.make(), sensor)


def _with_compiled_frames(made: gym.Env[Any, Any], variant: ShieldVariant) -> tuple[gym.Env[Any, Any], bool]:
    """An environment on a road network with compiled frames; raises `ConfigError` if the shield supervises frames."""
    meta = made.unwrapped.config["action"]["type"] == "DiscreteMetaAction"  # type: ignore[attr-defined]
    if variant.placement == "policy" or (variant.placement == "env" and not (meta and variant.config.simulates)):
        raise ConfigError("frames are supervised one by one in highway-env itself")
    env = with_compiled_frames(made)
    return env, env.exact


def _check(policy: Any, variant: ShieldVariant, model: str | None) -> None:
    """Raise `ConfigError` if the policy or the shield reads more of highway-env than the compiled copy has."""
    if variant.placement not in ("none", "env") and variant != variant_for(variant.config):
        raise ConfigError(f"placement {variant.placement!r} is for highway-env; the compiled highway has none and env")
    if model not in (None, "bicycle"):
        raise ConfigError(f"the model {model!r} is read from highway-env; the compiled highway has the bicycle")
    if not isinstance(policy, str) or not (policy in _READY or policy in list_references() or policy.endswith(".zip")):
        raise ConfigError(
            f"{policy if isinstance(policy, str) else type(policy).__name__} may read highway-env's objects; in the "
            f"compiled highway drive {', '.join(_READY)}, reference policies and SB3 .zip files"
        )
