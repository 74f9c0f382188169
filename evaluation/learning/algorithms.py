"""The algorithms of Stable-Baselines3 and sb3-contrib by name, and which of them a saved model was trained with.

Nothing here imports them before one is asked for.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from shield.errors import ConfigError, PolicyError

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

__all__ = ["ALGORITHMS", "algorithm_of", "get_algorithm", "load_model"]

ALGORITHMS: Mapping[str, str] = MappingProxyType(
    {
        "a2c": "stable_baselines3.A2C",
        "ddpg": "stable_baselines3.DDPG",
        "dqn": "stable_baselines3.DQN",
        "ppo": "stable_baselines3.PPO",
        "sac": "stable_baselines3.SAC",
        "td3": "stable_baselines3.TD3",
        "ars": "sb3_contrib.ARS",
        "crossq": "sb3_contrib.CrossQ",
        "maskableppo": "sb3_contrib.MaskablePPO",
        "qrdqn": "sb3_contrib.QRDQN",
        "recurrentppo": "sb3_contrib.RecurrentPPO",
        "tqc": "sb3_contrib.TQC",
        "trpo": "sb3_contrib.TRPO",
    }
)
"""Where the class of each algorithm is, by lower-case name."""

_POLICIES = {
    "stable_baselines3.dqn": "dqn",
    "stable_baselines3.sac": "sac",
    "stable_baselines3.td3": "td3",
    "sb3_contrib.ars": "ars",
    "sb3_contrib.crossq": "crossq",
    "sb3_contrib.common.maskable": "maskableppo",
    "sb3_contrib.common.recurrent": "recurrentppo",
    "sb3_contrib.qrdqn": "qrdqn",
    "sb3_contrib.tqc": "tqc",
}
"""Which algorithm a policy class is of; those of `stable_baselines3.common` are told by their settings."""


def get_algorithm(name: str) -> type[BaseAlgorithm]:
    """The class of that name, in any case.

    Raises
    ------
    ConfigError
        If there is no such algorithm, or sb3-contrib is not installed.
    """
    where = ALGORITHMS.get(name.lower().replace("_", "").replace("-", ""))
    if where is None:
        raise ConfigError(f"unknown algorithm {name!r}; have {', '.join(sorted(ALGORITHMS))}")
    module, _, kind = where.partition(".")
    try:
        found: type[BaseAlgorithm] = getattr(import_module(module), kind)
    except ImportError:
        raise ConfigError(f"{kind} is in sb3-contrib, which is not installed: pip install sb3-contrib") from None
    return found


def algorithm_of(path: Path) -> str | None:
    """The algorithm that a saved model was trained with, from what is written in it; None where that does not tell.

    Raises
    ------
    PolicyError
        If the file is no saved model.
    """
    data = _data(path)
    policy = data.get("policy_class")
    module = str(policy.get("__module__", "")) if isinstance(policy, dict) else ""
    for start, name in _POLICIES.items():
        if module.startswith(start):
            return name
    if "cg_damping" in data:
        return "trpo"
    if module.startswith("stable_baselines3.common"):
        return "ppo" if "clip_range" in data else "a2c"
    return None


def load_model(path: Path, algorithm: str) -> BaseAlgorithm:
    """A saved model, on the CPU.

    Raises
    ------
    ConfigError
        If there is no such algorithm.
    PolicyError
        If the file is no saved model, or was trained with another algorithm.
    """
    kind, trained = get_algorithm(algorithm), algorithm_of(path)
    same = {"ddpg": "td3"}.get(algorithm.lower(), algorithm.lower())
    if trained is not None and get_algorithm(trained) is not get_algorithm(same):
        raise PolicyError(f"{path.name} was trained with {trained}, not with {algorithm}; pass --algorithm {trained}")
    try:
        return kind.load(path, device="cpu")
    except Exception as error:
        raise PolicyError(f"{path.name} cannot be loaded as {algorithm}: {error}") from error


def _data(path: Path) -> Mapping[str, Any]:
    try:
        with zipfile.ZipFile(path) as archive:
            data = json.loads(archive.read("data"))
    except (OSError, zipfile.BadZipFile, KeyError, ValueError) as error:
        raise PolicyError(
            f"{path} is not a model saved by Stable-Baselines3: it holds no readable 'data' ({error})"
        ) from None
    return data if isinstance(data, dict) else {}
