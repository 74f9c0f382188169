"""Registration of an environment with Gymnasium: its specification, and the configuration that belongs to it."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from importlib import import_module
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
from gymnasium.envs.registration import EnvSpec, find_highest_version, get_env_id, parse_env_id

__all__ = ["registered_config", "spec_of"]


def spec_of(env_id: str) -> EnvSpec:
    """The specification of an id, as `gym.make` finds it.

    Parameters
    ----------
    env_id : a registered id; "module:id" imports the module first, an id without a version is the latest.

    Raises
    ------
    gymnasium.error.Error
        If the id is not registered.
    ImportError
        If the module cannot be imported.
    """
    module, _, name = env_id.rpartition(":")
    if module:
        import_module(module)
    if name not in gym.registry:
        namespace, base, version = parse_env_id(name)
        latest = find_highest_version(namespace, base) if version is None else None
        if latest is not None:
            name = get_env_id(namespace, base, latest)
    return gym.spec(name)


def registered_config(spec: EnvSpec) -> Mapping[str, Any]:
    """A copy of the configuration that an environment is registered with: changes of the default of its class."""
    return deepcopy(spec.kwargs.get("config")) or {}
