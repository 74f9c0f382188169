"""Identity of a row of results: the environment's configuration, the policy's files, the source of both, versions.

All values are plain (JSON). They are stored beside the rows, and compared before rows are added.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from highway_env import utils

from dynamics.scenes.registration import spec_of
from evaluation.learning.normalised_model import statistics_beside
from evaluation.policies import list_references, reference_file
from evaluation.settings import Setting
from shield.errors import PolicyError

__all__ = [
    "check_files",
    "differences",
    "file_hash",
    "hash_of_files",
    "model_hashes",
    "of_environment",
    "of_policy",
    "policy_files",
    "versions",
]

_PACKAGES = (
    *("highway-shield", "highway-env", "gymnasium", "stable-baselines3", "sb3-contrib", "torch", "numpy", "numba"),
    *("scipy", "casadi", "osqp"),
)
_VERSIONED = {
    *("builtins", "dynamics", "mpc", "shield", "evaluation"),
    *("highway_env", "gymnasium", "stable_baselines3", "sb3_contrib", "torch", "numpy"),
}
"""Top-level modules without a hash of their source, because `versions` identifies them."""
_SHORT = 40
"""Longest value that is shown in a message [characters]."""


def versions() -> dict[str, str]:
    """Versions of the installed libraries that can change a result."""
    found = {}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def of_environment(setting: Setting) -> dict[str, Any]:
    """Registration and configuration of an environment, and hashes of source that belongs to the user."""
    spec = spec_of(setting.env_id)
    env = setting.make()
    try:
        base: Any = env.unwrapped
        own: list[Any] = [*type(base).__mro__, *map(type, _layers(env))]
        if callable(spec.entry_point):
            own.append(spec.entry_point)
        traffic = base.config.get("other_vehicles_type")
        if isinstance(traffic, str):
            own.extend(utils.class_from_path(traffic).__mro__)
        return {
            "id": spec.id,
            "class": _name(type(base)),
            "arguments": {k: _plain(v) for k, v in spec.kwargs.items() if k not in ("config", "render_mode")},
            "decisions at most": spec.max_episode_steps,
            "wrappers": [_name(type(layer)) for layer in _layers(env)],
            "configuration": {key: _plain(value) for key, value in base.config.items()},
            "source": _sources(each.__module__ for each in own),
        }
    finally:
        env.close()


def policy_files(name: str, model: str | None = None) -> dict[str, Any]:
    """Hashes of the files of a policy.

    Parameters
    ----------
    name : as in `evaluation.running.named_policies.make_policy`.
    model : dynamics model of the policy, by name or as a folder.

    Returns
    -------
    `file` for the zip file, `statistics` for its normalisation statistics, and `model` for the folder's files; each
    only if it exists.
    """
    found = {}
    path = Path(name) if name.endswith(".zip") else reference_file(name) if name in list_references() else None
    if path is not None and path.is_file():
        found["file"] = _hash([path])
        beside = statistics_beside(path) if name.endswith(".zip") else None
        if beside is not None:
            found["statistics"] = _hash([beside])
    if model is not None and Path(model).is_dir():
        found["model"] = _hash(sorted(each for each in Path(model).rglob("*") if each.is_file()))
    return found


def model_hashes(policies: Iterable[str]) -> dict[str, str]:
    """Hash of each policy file by its name, of policies by name or as paths of zip files."""
    files = [Path(each) if each.endswith(".zip") else reference_file(each) for each in policies if _is_file(each)]
    return {each.name: file_hash(each) for each in files}


def hash_of_files(name: str, model: str | None = None) -> str:
    """Hashes of `policy_files` as one text."""
    return json.dumps(policy_files(name, model))


def check_files(name: str, model: str | None, before: str) -> None:
    """Check that the files of a policy have not changed.

    Parameters
    ----------
    name, model : as in `policy_files`.
    before : earlier result of `hash_of_files`.

    Raises
    ------
    PolicyError
        If one of the files has changed since.
    """
    if hash_of_files(name, model) != before:
        raise PolicyError(f"the files of policy {name} have changed while it was driven; begin again")


def of_policy(name: str, policy: Any = None, model: str | None = None) -> dict[str, Any]:
    """Hashes of a policy's files (see `policy_files`), and of source of its networks that belongs to the user.

    Parameters
    ----------
    name, model : as in `policy_files`.
    policy : the loaded policy, if it comes from a file.
    """
    actor: Any = getattr(getattr(policy, "model", policy), "policy", None)
    networks = actor.modules() if hasattr(actor, "modules") else []
    modules = {each.__module__ for network in networks for each in type(network).__mro__}
    return {**policy_files(name, model), "source": _sources(modules)}


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Differences of two mappings, in words; empty if they are equal.

    Parameters
    ----------
    before : the stored values.
    now : the values of the present run.

    Examples
    --------
    >>> differences({"seed": 5, "policy": {"file": "ab"}}, {"seed": 6, "policy": {"file": "cd"}})
    ['seed (5, now 6)', 'policy file (ab, now cd)']
    """
    found = []
    for key in [*now, *(key for key in before if key not in now)]:
        one, two = before.get(key), now.get(key)
        if isinstance(one, Mapping) and isinstance(two, Mapping):
            found += [f"{key} {each}" for each in differences(one, two)]
        elif one != two:
            old, new = ("none" if each is None else json.dumps(each).strip('"') for each in (one, two))
            found.append(f"{key} ({old}, now {new})" if max(len(old), len(new)) <= _SHORT else key)
    return found


def _layers(env: gym.Env[Any, Any]) -> list[gym.Env[Any, Any]]:
    """Wrappers of an environment, from the outermost to the innermost."""
    found: list[gym.Env[Any, Any]] = []
    while isinstance(env, gym.Wrapper):
        found.append(env)
        env = env.env
    return found


def _sources(modules: Iterable[str]) -> dict[str, str]:
    """Hash of the source of each module without a known version: of its file, or of all files of its package."""
    found: dict[str, str] = {}
    for name in sorted(set(modules)):
        top = name.partition(".")[0]
        if top in _VERSIONED or top in sys.stdlib_module_names:
            continue
        package, file = sys.modules.get(top), getattr(sys.modules.get(name), "__file__", None)
        folders = [Path(folder) for folder in getattr(package, "__path__", ())]
        files = [each for folder in folders for each in sorted(folder.rglob("*.py"))] or ([Path(file)] if file else [])
        found[top] = _hash(files) if files else "unknown"
    return found


def _is_file(policy: str) -> bool:
    return policy in list_references() or (policy.endswith(".zip") and Path(policy).is_file())


def file_hash(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _hash(files: Iterable[Path]) -> str:
    """Hash of the names and contents of files."""
    total = hashlib.sha256()
    for each in files:
        total.update(each.name.encode() + b"\0" + bytes.fromhex(file_hash(each)))
    return total.hexdigest()[:16]


def _name(kind: Any) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


def _plain(value: Any) -> Any:
    """A configuration value as a JSON value, the same in every process."""
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple | set):
        return [_plain(each) for each in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return _name(value if hasattr(value, "__qualname__") else type(value))
