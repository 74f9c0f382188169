"""Training of policies with Stable-Baselines3, and the recipes of the reference policies.

One thread, one seed, one zip file and beside it a JSON manifest that says how to make it again.
Training takes seeds below `FIRST_EVALUATION_SEED`; evaluation takes the others, so that no policy
is ever measured on traffic it was chosen on.
"""

from __future__ import annotations

import json
import platform
import shlex
import time
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium as gym
from stable_baselines3 import A2C, DQN, PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.monitor import Monitor

from evaluation.settings import Setting, get_setting
from evaluation.threads import one_thread
from shield.errors import ConfigError

__all__ = [
    "ALGORITHMS",
    "FIRST_EVALUATION_SEED",
    "RECIPES",
    "Recipe",
    "TrainedPolicy",
    "get_algorithm",
    "get_recipe",
    "manifest_path",
    "train",
    "train_recipe",
]

FIRST_EVALUATION_SEED = 10_000
"""Seeds below it are for training and choosing, from it on for evaluation."""

ALGORITHMS: Mapping[str, type[BaseAlgorithm]] = MappingProxyType(
    {"a2c": A2C, "dqn": DQN, "ppo": PPO, "sac": SAC, "td3": TD3}
)
"""The algorithms that `train` knows, by lower-case name."""

_ACTION_SPACES: dict[str, tuple[type[gym.Space[Any]], ...]] = {
    "a2c": (gym.spaces.Discrete, gym.spaces.Box),
    "dqn": (gym.spaces.Discrete,),
    "ppo": (gym.spaces.Discrete, gym.spaces.Box),
    "sac": (gym.spaces.Box,),
    "td3": (gym.spaces.Box,),
}
_PACKAGES = ("highway-shield", "highway-env", "gymnasium", "stable-baselines3", "torch", "numpy")


@dataclass(frozen=True)
class TrainedPolicy:
    """Where a trained policy lies and how it was made.

    Attributes:
        path: the zip file, to be loaded with the algorithm's own ``load``.
        manifest: what the JSON file beside it holds.
    """

    path: Path
    manifest: Mapping[str, Any]


@dataclass(frozen=True)
class Recipe:
    """All that `train` needs for one reference policy.

    Attributes:
        name: the name of the policy, and of its file.
        setting: a name in `evaluation.settings.SETTINGS`.
        algorithm: a name in `ALGORITHMS`.
        steps: environment steps (decisions of 1 s).
        seed: the training seed.
        hyperparameters: keyword arguments of the algorithm.
        description: one line for people.
    """

    name: str
    setting: str
    algorithm: str
    steps: int
    seed: int
    hyperparameters: Mapping[str, Any] = field(hash=False)
    description: str = ""


# The hyperparameters that highway-env's own examples use, but for the discount factor of the DQNs.
# Where a recipe's seed is not 0, the policy of seed 0 missed what the recipe is for (a PPO that crashes
# now and then, an adversary that nearly always does) on traffic seeds 0 to 49.
_PPO_HIGHWAY: dict[str, Any] = {
    "policy_kwargs": {"net_arch": {"pi": [256, 256], "vf": [256, 256]}},
    "n_steps": 160,
    "batch_size": 64,
    "n_epochs": 10,
    "learning_rate": 5e-4,
    "gamma": 0.8,
}
_DQN_ABZ: dict[str, Any] = {
    "policy_kwargs": {"net_arch": [256, 256]},
    "learning_rate": 5e-4,
    "buffer_size": 15_000,
    "learning_starts": 200,
    "batch_size": 32,
    "gamma": 0.9,
    "train_freq": 1,
    "gradient_steps": 1,
    "target_update_interval": 50,
}

RECIPES: Mapping[str, Recipe] = MappingProxyType(
    {
        recipe.name: recipe
        for recipe in (
            Recipe(
                "ppo-highway-fast",
                "highway-fast",
                "ppo",
                10_000,
                1,
                _PPO_HIGHWAY,
                "PPO on highway-fast-v0 as it comes: drives, and crashes now and then",
            ),
            Recipe(
                "dqn-abz-base",
                "abz",
                "dqn",
                20_000,
                0,
                _DQN_ABZ,
                "DQN on the ABZ 2025 highway, crash reward -1",
            ),
            Recipe(
                "dqn-abz-adversarial",
                "abz-adversarial",
                "dqn",
                20_000,
                1,
                _DQN_ABZ,
                "DQN on the ABZ 2025 highway, crash reward +1: it has learned to crash",
            ),
        )
    }
)
"""The recipes of the reference policies in `evaluation.policies`."""


def get_algorithm(name: str) -> type[BaseAlgorithm]:
    """The Stable-Baselines3 class of that name (any case); a `ConfigError` if there is none."""
    try:
        return ALGORITHMS[name.lower()]
    except KeyError:
        raise ConfigError(f"unknown algorithm {name!r}; have {sorted(ALGORITHMS)}") from None


def get_recipe(name: str) -> Recipe:
    """The recipe of that name; a `ConfigError` that lists the names if there is none."""
    try:
        return RECIPES[name]
    except KeyError:
        raise ConfigError(f"unknown recipe {name!r}; have {sorted(RECIPES)}") from None


def manifest_path(policy: Path) -> Path:
    """Where the manifest of a policy file lies: beside it, as ``.json``."""
    return policy.with_suffix(".json")


def train(
    setting: str | Setting,
    algorithm: str,
    steps: int,
    seed: int,
    *,
    output: str | Path,
    hyperparameters: Mapping[str, Any] | None = None,
    progress: bool = True,
    command: str | None = None,
) -> TrainedPolicy:
    """Train a policy on one thread of the processor and save it with its manifest.

    Args:
        setting: the environment to train in, by name or as a `Setting`.
        algorithm: a name in `ALGORITHMS`.
        steps: environment steps, 1 s of driving each by default. PPO and A2C round up to whole
            rollouts; the manifest has both numbers.
        seed: 0 to 9,999; seeds from `FIRST_EVALUATION_SEED` on belong to evaluation.
        output: the zip file to write; the suffix is added if it is missing.
        hyperparameters: keyword arguments of the algorithm; what is not given is
            Stable-Baselines3's default, with the policy "MlpPolicy".
        progress: whether to show a progress bar.
        command: the shell command that repeats this; by default one that calls this function.

    Returns:
        The written file and its manifest.
    """
    algorithm = algorithm.lower()
    algorithm_class = get_algorithm(algorithm)
    setting = get_setting(setting) if isinstance(setting, str) else setting
    parameters = dict(hyperparameters or {})
    path = _check(steps, seed, output)

    env = Monitor(setting.make())
    try:
        accepted = _ACTION_SPACES[algorithm]
        if not isinstance(env.action_space, accepted):
            fitting = sorted(n for n, kinds in _ACTION_SPACES.items() if isinstance(env.action_space, kinds))
            raise ConfigError(
                f"{algorithm} cannot act in {setting.name!r}, whose actions are {env.action_space}; have {fitting}"
            )
        started = time.perf_counter()
        with one_thread():
            # A copy: Stable-Baselines3 writes its own entries into `policy_kwargs`.
            arguments = {"policy": "MlpPolicy", **deepcopy(parameters)}
            model = algorithm_class(**arguments, env=env, seed=seed, device="cpu")
            model.learn(steps, progress_bar=progress)
        seconds = time.perf_counter() - started
        path.parent.mkdir(parents=True, exist_ok=True)
        model.save(path)
    finally:
        env.close()

    manifest = {
        "command": command or _call(setting, algorithm, steps, seed, parameters, path),
        "algorithm": algorithm,
        "setting": {
            "name": setting.name,
            "env_id": setting.env_id,
            "config": dict(setting.config),
        },
        "steps": steps,
        "steps_taken": model.num_timesteps,
        "seed": seed,
        "hyperparameters": parameters,
        "training_seconds": round(seconds, 1),
        "versions": {"python": platform.python_version(), **{p: version(p) for p in _PACKAGES}},
    }
    manifest_path(path).write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
    return TrainedPolicy(path=path, manifest=manifest)


def train_recipe(name: str, output: str | Path | None = None, *, progress: bool = True) -> TrainedPolicy:
    """Train a reference policy again, by default into ``runs/policies/NAME.zip``.

    Args:
        name: a name in `RECIPES`.
        output: the zip file to write instead.
        progress: whether to show a progress bar.
    """
    recipe = get_recipe(name)
    return train(
        recipe.setting,
        recipe.algorithm,
        recipe.steps,
        recipe.seed,
        hyperparameters=recipe.hyperparameters,
        output=output if output is not None else Path("runs", "policies", f"{name}.zip"),
        progress=progress,
        command=f"shield train --recipe {name}",
    )


def _check(steps: int, seed: int, output: str | Path) -> Path:
    if steps <= 0:
        raise ConfigError(f"steps must be positive, not {steps}")
    if not 0 <= seed < FIRST_EVALUATION_SEED:
        raise ConfigError(
            f"training seeds are 0 to {FIRST_EVALUATION_SEED - 1}, not {seed}: the others are kept for evaluation"
        )
    path = Path(output)
    return path if path.suffix == ".zip" else path.with_name(path.name + ".zip")


def _call(setting: Setting, algorithm: str, steps: int, seed: int, parameters: dict[str, Any], path: Path) -> str:
    code = (
        "from evaluation.settings import Setting; from evaluation.training import train; "
        f"train(Setting({setting.name!r}, {setting.env_id!r}, {dict(setting.config)!r}), "
        f"{algorithm!r}, {steps}, {seed}, hyperparameters={parameters!r}, output={path.name!r})"
    )
    return f"python -c {shlex.quote(code)}"
