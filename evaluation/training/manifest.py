"""Manifest of a trained policy, the JSON file beside it."""

from __future__ import annotations

import platform
import shlex
from importlib.metadata import version
from typing import Any

from evaluation.training.options import TrainingOptions

__all__ = ["manifest_of"]

_PACKAGES = ("highway-shield", "highway-env", "gymnasium", "stable-baselines3", "torch", "numpy")
_APART = ("setting", "env_id", "env_config", "actions", "algorithm", "steps", "seed", "output", "hyperparameters")
"""Options that the manifest has under other names, or that are positional arguments of `train`."""
_OF_THE_RUN = ("resume", "tensorboard", "masks")
"""Options that are not part of the call that repeats a training; masks are implied by the algorithm."""


def manifest_of(options: TrainingOptions, command: str | None = None) -> dict[str, Any]:
    """The part of the manifest that is known before a training.

    Parameters
    ----------
    options : the options of the training.
    command : shell command that repeats it; by default a call of `train`.
    """
    setting, parameters = options.environment, options.plain()["hyperparameters"]
    own = {key: value for key, value in options.over(envs=4).differing().items() if key not in (*_APART, *_OF_THE_RUN)}
    if options.envs != 1:
        own["envs"] = options.envs
    return {
        "command": command or _call(options, parameters, own),
        "algorithm": options.learner,
        "setting": {"name": setting.name, "env_id": setting.env_id, "config": dict(setting.config)},
        "steps": options.steps,
        "seed": options.seed,
        "hyperparameters": parameters,
        **own,
        "versions": {"python": platform.python_version(), **{each: version(each) for each in _PACKAGES}},
    }


def _call(options: TrainingOptions, parameters: dict[str, Any], own: dict[str, Any]) -> str:
    more = "".join(f", {name}={value!r}" for name, value in own.items())
    setting = options.environment
    code = (
        "from evaluation.settings import Setting; from evaluation.training.train import train; "
        f"train(Setting({setting.name!r}, {setting.env_id!r}, {dict(setting.config)!r}), "
        f"{options.learner!r}, {options.steps}, {options.seed}, hyperparameters={parameters!r}{more}, "
        f"output={options.path.name!r})"
    )
    return f"python -c {shlex.quote(code)}"
