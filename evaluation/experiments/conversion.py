"""Conversion of the user's policies and environments to names, files and settings."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import gymnasium as gym

from evaluation.learning.normalised_model import statistics_beside
from evaluation.settings import SETTINGS, Setting, setting_of
from shield.errors import ConfigError

__all__ = ["as_file", "name_of", "origin_of", "setting_given"]

_KEPT = ("OrderEnforcing", "PassiveEnvChecker", "TimeLimit")
"""Wrappers that `gym.make` adds again."""


def name_of(policy: Any) -> str:
    """Default name of a policy in reports."""
    if isinstance(policy, str | Path):
        return Path(policy).stem if str(policy).endswith(".zip") else str(policy)
    return str(getattr(policy, "__name__", type(policy).__name__)).strip("<>")


def origin_of(policy: Any) -> str:
    """Module and name of the function or class of a policy that is an object."""
    named = policy if hasattr(policy, "__qualname__") else type(policy)
    return f"{named.__module__}.{named.__qualname__}"


def as_file(name: str, policy: Any, folder: Path) -> Any:
    """A policy by name or file, for all processes.

    A zip file with another name is copied. An SB3 model is saved, with its statistics. Other objects are returned
    unchanged.
    """
    if isinstance(policy, str | Path):
        return str(policy) if name_of(policy) == name else _copied(name, str(policy), folder)
    if not (hasattr(policy, "save") and hasattr(policy, "get_vec_normalize_env")):
        return policy
    path = folder / f"{name}.zip"
    policy.save(path)
    statistics = policy.get_vec_normalize_env()
    if statistics is not None:
        statistics.save(str(folder / f"{name}_vecnormalize.pkl"))
    return str(path)


def _copied(name: str, policy: str, folder: Path) -> str:
    """Copy a zip file and its statistics to another name."""
    if not policy.endswith(".zip"):
        raise ConfigError(f"the policy {policy!r} is reported as {policy!r}, and under no other name such as {name!r}")
    path = folder / f"{name}.zip"
    shutil.copyfile(policy, path)
    statistics = statistics_beside(Path(policy))
    if statistics is not None:
        shutil.copyfile(statistics, folder / f"{name}_vecnormalize.pkl")
    return str(path)


def setting_given(env: Any) -> Setting:
    """The setting of a name, an id, or an environment that has been made.

    Raises
    ------
    ConfigError
        If the environment is unknown, was not made by `gym.make`, or has wrappers that would be lost.
    """
    if isinstance(env, Setting):
        return env
    if isinstance(env, str):
        return SETTINGS[env] if env in SETTINGS else setting_of(env)
    if not isinstance(env, gym.Env):
        raise ConfigError(f"{type(env).__name__} is no environment; valid are names of settings, ids, and gym.Env")
    layer: Any = env
    while isinstance(layer, gym.Wrapper):
        if type(layer).__name__ not in _KEPT:
            raise ConfigError(
                f"{type(layer).__name__} around the environment would be lost, since each process makes its own: "
                "register the environment with it (additional_wrappers=) and give the id"
            )
        layer = layer.env
    if layer.spec is None:
        raise ConfigError(f"{type(layer).__name__} was not made by gym.make: register it, and give the id")
    return Setting(layer.spec.id, layer.spec.id, layer.config)
