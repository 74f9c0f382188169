"""The reference policies for the project's measurements: trained, small, and reproducible.

Each is a Stable-Baselines3 zip with a manifest beside it. `load_reference` takes the algorithm's
class from the manifest:
>>> model = load_reference("dqn-abz-base")
>>> type(model).__name__
'DQN'
"""

from __future__ import annotations

import json
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import gymnasium as gym
from stable_baselines3.common.base_class import BaseAlgorithm

from evaluation.learning.algorithms import get_algorithm
from evaluation.names import list_references
from shield.errors import ConfigError

__all__ = ["list_references", "load_reference", "reference_file", "reference_manifest"]

_HERE = files(__name__)


def reference_manifest(name: str) -> dict[str, Any]:
    """The manifest of a policy: its training, and its measured results; raises `ConfigError` for an unknown name."""
    if name not in list_references():
        raise ConfigError(f"unknown reference policy {name!r}; have {list_references()}")
    manifest: dict[str, Any] = json.loads((_HERE / f"{name}.json").read_text(encoding="utf-8"))
    return manifest


def load_reference(name: str, env: gym.Env[Any, Any] | None = None) -> BaseAlgorithm:
    """Load a reference policy on the CPU.

    Parameters
    ----------
    name : a name in `list_references`.
    env : an environment to attach, with the spaces of the policy's training.
    """
    algorithm = get_algorithm(reference_manifest(name)["algorithm"])
    with as_file(_HERE / f"{name}.zip") as path:
        return algorithm.load(path, env=env, device="cpu")


def reference_file(name: str) -> Path:
    """Path of the zip file of a reference policy."""
    return Path(str(_HERE / f"{name}.zip"))
