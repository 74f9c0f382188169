"""The algorithms of Stable-Baselines3 and sb3-contrib by name, and the algorithm of a saved model.

They are imported on use only.
"""

from __future__ import annotations

import inspect
import logging
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from evaluation.learning.saved_objects import misfits, read_data, read_objects
from evaluation.names import check_name
from shield.errors import ConfigError, PolicyError

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

__all__ = ["ALGORITHMS", "algorithm_named", "algorithm_of", "get_algorithm", "load_model"]

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
"""Dotted name of each algorithm's class, by lower-case name."""

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
"""Algorithm of a policy class, by its module; classes of `stable_baselines3.common` are identified by settings."""

_log = logging.getLogger(__name__)
_NETWORK = ("policy_class", "policy_kwargs")
"""Objects that define the network."""
_SPACES = ("observation_space", "action_space")
_BUFFER: Mapping[str, Any] = MappingProxyType(
    {"replay_buffer_class": None, "replay_buffer_kwargs": {}, "buffer_size": 1, "optimize_memory_usage": False}
)
"""Settings for the smallest replay buffer of an off-policy algorithm, for any environment."""


def algorithm_named(name: str) -> str:
    """The key in `ALGORITHMS` of a name in any case, with dashes or without.

    Raises
    ------
    ConfigError
        If there is no such algorithm.
    """
    key = name.lower().replace("_", "").replace("-", "")
    check_name("algorithm", key, sorted(ALGORITHMS))
    return key


def get_algorithm(name: str) -> type[BaseAlgorithm]:
    """The class with that name, in any case.

    Raises
    ------
    ConfigError
        If there is no such algorithm, or sb3-contrib is not installed.
    """
    where = ALGORITHMS[algorithm_named(name)]
    module, _, kind = where.partition(".")
    try:
        found: type[BaseAlgorithm] = getattr(import_module(module), kind)
    except ImportError:
        raise ConfigError(f"{kind} is in sb3-contrib, which is not installed: pip install sb3-contrib") from None
    return found


def algorithm_of(path: Path) -> str | None:
    """The algorithm of a saved model, from the contents of its file; None if they do not identify it.

    Raises
    ------
    PolicyError
        If the file is no saved model.
    """
    data = read_data(path)
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


def load_model(
    path: str | Path,
    algorithm: str | None = None,
    env: Any = None,
    custom_objects: Mapping[str, Any] | None = None,
) -> BaseAlgorithm:
    """A saved model on the CPU, for predictions. To train it further, load it with SB3: `SAC.load(path, env=env)`.

    Parts that only training needs are left out: the replay buffer, and objects that cannot be unpickled here, such as a
    learning rate schedule of another Python. Spaces that cannot be unpickled (models of gym's time, SB3 1.x) are
    replaced by those of `env`, with a warning.

    Parameters
    ----------
    path : path of the zip file.
    algorithm : name of its algorithm; by default from the file.
    env : the environment of the model; only its spaces are read.
    custom_objects : objects by name that replace those in the file, as in SB3's `load`.

    Raises
    ------
    ConfigError
        If there is no such algorithm, or the file does not contain it and none is given.
    PolicyError
        If the file is no saved model, was trained with another algorithm or for other spaces, or an object that
        prediction needs cannot be unpickled. The message names the object and the remedy.
    """
    path = Path(path)
    data = read_data(path)
    algorithm, kind = _agreed(path, algorithm)
    objects, unreadable = read_objects(data, custom_objects or {})
    if lost := [name for name in _NETWORK if name in unreadable]:
        raise PolicyError(_unreadable(path, kind, data, lost[0], unreadable[lost[0]]))
    taken = {name: _space(path, name, data, env, unreadable[name]) for name in _SPACES if name in unreadable}
    # Other unreadable objects have no part in predictions and get the algorithm's default.
    parameters = inspect.signature(kind.__init__).parameters
    for name in unreadable.keys() - taken.keys():
        parameter = parameters.get(name)
        objects[name] = None if parameter is None or parameter.default is parameter.empty else parameter.default
        _log.info("%s: %s cannot be read (%s) and is left out", path.name, name, unreadable[name])
    # A replay buffer is for training; that of hindsight experience replay would need the environment.
    stored = {name: objects.get(name, data[name]) for name in _BUFFER if name in data}
    objects = {**objects, **taken, **{name: _BUFFER[name] for name in stored}}
    try:
        model = kind.load(path, device="cpu", custom_objects=objects)
    except Exception as error:
        raise PolicyError(f"{path.name} cannot be loaded as {algorithm}: {error}") from error
    if stored:
        vars(model).update(stored, replay_buffer=None)
    if taken:
        _log.warning("%s: %s cannot be read here; those of the environment are taken", path.name, " and ".join(taken))
    return model


def _agreed(path: Path, algorithm: str | None) -> tuple[str, type[BaseAlgorithm]]:
    """The algorithm of a saved model and its class: the given one, which has to agree with the file, or else that of
    the file."""
    trained = algorithm_of(path)
    algorithm = algorithm or trained
    if algorithm is None:
        raise ConfigError(
            f"{path} does not say which algorithm it was trained with; give one, in Python with load_model(path,"
            f" algorithm), on the command line with --algorithm: {', '.join(sorted(ALGORITHMS))}"
        )
    kind = get_algorithm(algorithm)
    same = {"ddpg": "td3"}.get(algorithm.lower(), algorithm.lower())
    if trained is not None and get_algorithm(trained) is not get_algorithm(same):
        raise PolicyError(f"{path.name} was trained with {trained}, not with {algorithm}; pass --algorithm {trained}")
    return algorithm, kind


def _space(path: Path, name: str, data: Mapping[str, Any], env: Any, error: Exception) -> Any:
    """The environment's space in place of one that cannot be unpickled."""
    if env is None:
        raise PolicyError(
            f"{path.name}: its {name} cannot be read here ({_error_text(error)}); hand in the environment that "
            f"it was trained in: load_model(path, env=env)"
        )
    space = getattr(env, f"single_{name}", None) or getattr(env, name)
    if different := misfits(data[name], space):
        raise PolicyError(f"{path.name} was trained with another {name}: {different[0]}")
    return space


def _unreadable(path: Path, kind: type[BaseAlgorithm], data: Mapping[str, Any], name: str, error: Exception) -> str:
    """Message about an unreadable object of the network, with the remedy in Python."""
    item = data.get(name)
    known = {key: value for key, value in item.items() if not key.startswith((":", "__"))} if item else {}
    listed = f" The file says that it holds {known}." if known and name == "policy_kwargs" else ""
    load = f"{kind.__name__}.load({str(path)!r}, custom_objects={{{name!r}: ...}})"
    return (
        f"{path.name}: its {name} cannot be read here ({_error_text(error)}).{listed} Load it in Python, where the "
        f"class is defined, model = {load}, and hand the model to Shield, "
        "ShieldedEnv or run_paired; or model.save() it under another name, which this command reads"
    )


def _error_text(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"
