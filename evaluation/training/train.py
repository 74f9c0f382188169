"""Reproducible training of a policy with Stable-Baselines3, with a manifest beside the model."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import CallbackList
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from evaluation.learning.algorithms import get_algorithm
from evaluation.learning.manifests import manifest_path
from evaluation.learning.normalisation import fold, normalised
from evaluation.learning.recipes import get_recipe
from evaluation.running.identity import file_hash
from evaluation.running.manifest import commit
from evaluation.settings import Setting
from evaluation.threads import one_thread
from evaluation.training.checkpoints import Checkpoints
from evaluation.training.counting import CountSteps
from evaluation.training.executed_actions import LearnFromExecuted
from evaluation.training.manifest import manifest_of
from evaluation.training.named_classes import with_classes
from evaluation.training.options import TrainingOptions
from evaluation.training.periodic_evaluation import PeriodicEvaluation
from evaluation.training.worlds import TrainingEnvs, make_training_envs
from shield.errors import ConfigError

__all__ = ["TrainedPolicy", "train", "train_recipe", "train_with"]

_log = logging.getLogger(__name__)

_ACTION_SPACES: dict[str, tuple[type[gym.Space[Any]], ...]] = {
    "a2c": (gym.spaces.Discrete, gym.spaces.Box),
    "dqn": (gym.spaces.Discrete,),
    "maskableppo": (gym.spaces.Discrete,),
    "ppo": (gym.spaces.Discrete, gym.spaces.Box),
    "sac": (gym.spaces.Box,),
    "td3": (gym.spaces.Box,),
    "trpo": (gym.spaces.Discrete, gym.spaces.Box),
}


@dataclass(frozen=True)
class TrainedPolicy:
    """A trained policy and its manifest.

    Attributes
    ----------
    path : path of the zip file, to be loaded with the algorithm's own `load`.
    manifest : contents of the JSON file beside it.
    """

    path: Path
    manifest: Mapping[str, Any]


def train(
    setting: str | Setting,
    algorithm: str,
    steps: int,
    seed: int,
    *,
    output: str | Path,
    progress: bool = True,
    **options: Any,
) -> TrainedPolicy:
    """Train a policy on one thread of the processor and save it with its manifest.

    Parameters
    ----------
    setting, algorithm, steps, seed, output : as in `TrainingOptions`.
    progress : whether to show a progress bar.
    options : the other fields of `TrainingOptions`; `envs` is 1 by default.

    Returns
    -------
    The written file and its manifest.

    Raises
    ------
    ConfigError
        If an option is not valid, or the algorithm cannot learn in this environment.
    """
    known = TrainingOptions.names()
    unknown = [name for name in options if name not in known]
    if unknown:
        raise ConfigError(f"unknown training option {unknown[0]!r}; have {', '.join(known)}")
    given: dict[str, Any] = {"envs": 1, **options}
    whole = TrainingOptions(setting=setting, algorithm=algorithm, steps=steps, seed=seed, output=Path(output), **given)
    return train_with(whole, progress=progress)


def train_recipe(
    name: str,
    output: str | Path | None = None,
    *,
    steps: int | None = None,
    simulator: str = "auto",
    sensor: str = "exact",
    progress: bool = True,
) -> TrainedPolicy:
    """Train a reference policy again, by default into `runs/policies/NAME.zip`, or `NAME-SENSOR.zip`.

    Parameters
    ----------
    name : a name in `evaluation.learning.recipes.RECIPES`.
    output : path of another zip file.
    steps : training steps instead of the recipe's.
    simulator, sensor : as in `TrainingOptions`; a sensor only if the recipe has none.
    progress : whether to show a progress bar.

    Raises
    ------
    ConfigError
        If the name is unknown, or both the recipe and the call have a sensor.
    """
    recipe = get_recipe(name)
    if sensor != "exact" and recipe.sensor != "exact":
        raise ConfigError(f"the recipe {name!r} has a sensor, {recipe.sensor!r}: it takes no other")
    steps = recipe.steps if steps is None else steps
    file = name if sensor == "exact" else f"{name}-{sensor}"
    more = "" if steps == recipe.steps else f" --steps {steps}"
    more += "" if sensor == "exact" else f" --sensor {sensor}"
    options = TrainingOptions(
        setting=recipe.setting,
        algorithm=recipe.algorithm,
        steps=steps,
        seed=recipe.seed,
        envs=1,
        hyperparameters=recipe.hyperparameters,
        normalise=recipe.normalise,
        exploration=recipe.exploration,
        fast=recipe.fast,
        simulator=simulator,
        shield=recipe.shield,
        sensor=recipe.sensor if sensor == "exact" else sensor,
        output=Path(output) if output is not None else Path("runs", "policies", f"{file}.zip"),
    )
    return train_with(options, progress=progress, command=f"shield train --recipe {name}{more}")


def train_with(options: TrainingOptions, *, progress: bool = True, command: str | None = None) -> TrainedPolicy:
    """Train a policy with the given options.

    Parameters
    ----------
    options : the options.
    progress : whether to show a progress bar.
    command : shell command that repeats this; by default a call of `train`.

    Returns
    -------
    The written file and its manifest.

    Raises
    ------
    ConfigError
        If the algorithm cannot learn in this environment or has no such hyperparameters, a package is missing, or
        the checkpoints belong to other options.
    """
    if options.tensorboard is not None and find_spec("tensorboard") is None:
        raise ConfigError(
            "logging to TensorBoard needs the package tensorboard: pip install 'highway-shield[tensorboard]'"
        )
    get_algorithm(options.learner)
    world = make_training_envs(options)
    callbacks: _Callbacks | None = None
    try:
        _check_actions(options, world.env.action_space)
        callbacks = _Callbacks.of(options)
        started = time.perf_counter()
        with one_thread():
            model = _learned(options, world, callbacks, progress)
        seconds = time.perf_counter() - started
        options.path.parent.mkdir(parents=True, exist_ok=True)
        model.save(options.path)
    finally:
        world.env.close()
        if callbacks is not None and callbacks.evaluation is not None:
            callbacks.evaluation.close()
    manifest = {
        **manifest_of(options, command),
        "steps_taken": model.num_timesteps,
        "simulator": world.driven_in,
        "training_seconds": round(seconds, 1),
        **callbacks.as_dict(),
        "commit": commit(),
        "sha256": file_hash(options.path),
    }
    manifest_path(options.path).write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
    return TrainedPolicy(path=options.path, manifest=manifest)


@dataclass(frozen=True)
class _Callbacks:
    """Callbacks of a training."""

    counts: CountSteps
    evaluation: PeriodicEvaluation | None
    checkpoints: Checkpoints | None

    @classmethod
    def of(cls, options: TrainingOptions) -> _Callbacks:
        """The callbacks for the options; raises `ConfigError` for checkpoints of another training."""
        checkpoints = Checkpoints.of(options)
        counts, evaluation = CountSteps(), PeriodicEvaluation.of(options)
        if checkpoints is not None:
            checkpoints.attach(counts, evaluation)
        return cls(counts, evaluation, checkpoints)

    def listed(self, options: TrainingOptions) -> CallbackList:
        """The callbacks in order; the checkpoint comes after the callbacks with saved state."""
        executed = LearnFromExecuted() if options.learn_from == "executed" else None
        written = None if self.checkpoints is None else self.checkpoints.callback
        return CallbackList([each for each in (self.counts, executed, self.evaluation, written) if each is not None])

    def as_dict(self) -> dict[str, Any]:
        """Entries of the manifest."""
        return {
            "in_training": dict(self.counts.counts),
            **({} if self.evaluation is None else {"best": self.evaluation.best}),
            **({} if self.checkpoints is None else {"resumed": self.checkpoints.resumed}),
        }


def _learned(options: TrainingOptions, world: TrainingEnvs, callbacks: _Callbacks, progress: bool) -> BaseAlgorithm:
    """Train and return the final model."""
    model = _model(options, world, callbacks.checkpoints)
    done = model.num_timesteps
    left = max(options.steps - done, 0)
    _tell_rollouts(model, left)
    if options.exploration and not done:
        _explore(model, options.exploration)
    model.learn(
        left,
        callback=callbacks.listed(options),
        reset_num_timesteps=not done,
        progress_bar=progress,
    )
    if "observations" in options.normalise:
        fold(model)
    return model


def _tell_rollouts(model: BaseAlgorithm, steps: int) -> None:
    """Warn if more steps are driven than requested, because on-policy algorithms finish a rollout."""
    if not isinstance(model, OnPolicyAlgorithm):
        return
    rollout = model.n_steps * model.n_envs
    driven = -(-steps // rollout) * rollout
    if driven != steps:
        _log.warning(
            "%d steps are driven, not %d: a rollout has n_steps x environments = %d x %d steps; "
            "--set n_steps=N and --envs change that",
            driven, steps, model.n_steps, model.n_envs,
        )  # fmt: skip


def _check_actions(options: TrainingOptions, actions: gym.Space[Any]) -> None:
    if not isinstance(actions, _ACTION_SPACES[options.learner]):
        fitting = sorted(n for n, kinds in _ACTION_SPACES.items() if isinstance(actions, kinds))
        raise ConfigError(
            f"{options.learner} cannot act in {options.environment.name!r}, whose actions are {actions}; have {fitting}"
        )


def _model(options: TrainingOptions, world: TrainingEnvs, checkpoints: Checkpoints | None) -> BaseAlgorithm:
    """A new model, or that of the last checkpoint."""
    parameters = with_classes(options.hyperparameters)
    env: Any = world.env
    if options.normalise:
        env = normalised(env, options.normalise, parameters.get("gamma", 0.99))
    if checkpoints is not None and checkpoints.last is not None:
        return checkpoints.load(env if isinstance(env, VecEnv) else DummyVecEnv([lambda: env]))
    # Copied, because Stable-Baselines3 writes its own entries into `policy_kwargs`.
    arguments = {"policy": "MlpPolicy", **deepcopy(parameters)}
    if options.tensorboard is not None:
        arguments["tensorboard_log"] = str(options.tensorboard)
    try:
        return get_algorithm(options.learner)(**arguments, env=env, seed=options.seed, device="cpu")
    except TypeError as error:
        raise ConfigError(f"{options.learner} takes no such hyperparameters: {error}") from None


def _explore(model: BaseAlgorithm, deviations: Sequence[float]) -> None:
    """Set the standard deviation of each action."""
    log_std: Any = getattr(model.policy, "log_std", None)
    actions = 0 if log_std is None else len(log_std)
    if actions != len(deviations) or min(deviations) <= 0:
        raise ConfigError(
            f"exploration is a positive number for each continuous action of PPO or A2C, of which there are {actions}"
            f" here; got {list(deviations)}"
        )
    with torch.no_grad():
        log_std.copy_(torch.log(torch.tensor(deviations)))
