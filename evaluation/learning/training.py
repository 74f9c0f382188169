"""Training of policies with Stable-Baselines3.

One thread, one seed, one zip file and beside it a JSON manifest that says how to make it again.
Training takes seeds below `FIRST_EVALUATION_SEED`; evaluation takes the others, so that no policy
is ever measured on traffic it was chosen on.
"""

from __future__ import annotations

import json
import platform
import shlex
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, cast

import gymnasium as gym
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from dynamics.networks.refusals import on_network
from dynamics.simulator.env import CompiledHighwayEnv
from evaluation.learning.algorithms import get_algorithm
from evaluation.learning.normalisation import NORMALISABLE, fold, normalised
from evaluation.learning.observations import FastObservations
from evaluation.learning.recipes import get_recipe
from evaluation.names import FIRST_EVALUATION_SEED, TRAINABLE, check_name
from evaluation.settings import Setting, get_setting
from evaluation.simulators import compiled_where_it_serves, with_compiled_frames
from evaluation.threads import one_thread
from evaluation.wrappers.channels import seen_through
from shield import ShieldConfig, ShieldedEnv
from shield.errors import ConfigError

__all__ = [
    "TrainedPolicy",
    "manifest_path",
    "train",
    "train_recipe",
]

_ACTION_SPACES: dict[str, tuple[type[gym.Space[Any]], ...]] = {
    "a2c": (gym.spaces.Discrete, gym.spaces.Box),
    "dqn": (gym.spaces.Discrete,),
    "ppo": (gym.spaces.Discrete, gym.spaces.Box),
    "sac": (gym.spaces.Box,),
    "td3": (gym.spaces.Box,),
    "trpo": (gym.spaces.Discrete, gym.spaces.Box),
}
_ON_POLICY = ("a2c", "ppo")
_PACKAGES = ("highway-shield", "highway-env", "gymnasium", "stable-baselines3", "torch", "numpy")


@dataclass(frozen=True)
class TrainedPolicy:
    """Where a trained policy lies and how it was made.

    Attributes
    ----------
    path : the zip file, to be loaded with the algorithm's own `load`. manifest : what the JSON file beside it holds.
    """

    path: Path
    manifest: Mapping[str, Any]


def manifest_path(policy: Path) -> Path:
    """Where the manifest of a policy file lies: beside it, as `.json`."""
    return policy.with_suffix(".json")


def train(
    setting: str | Setting,
    algorithm: str,
    steps: int,
    seed: int,
    *,
    output: str | Path,
    hyperparameters: Mapping[str, Any] | None = None,
    normalise: Collection[str] = (),
    exploration: Sequence[float] = (),
    fast: bool = False,
    simulator: str = "auto",
    shield: str = "none",
    sensor: str = "exact",
    envs: int = 1,
    tensorboard: str | Path | None = None,
    progress: bool = True,
    command: str | None = None,
) -> TrainedPolicy:
    """Train a policy on one thread of the processor and save it with its manifest.

    Parameters
    ----------
    setting : the environment to train in, by name or as a `Setting`.
    algorithm : one of `TRAINABLE`.
    steps : environment steps (decisions). PPO and A2C round up to whole
        rollouts; the manifest has both numbers.
    seed : 0 to 9,999; seeds from `FIRST_EVALUATION_SEED` on belong to evaluation.
    output : the zip file to write; the suffix is added if it is missing.
    hyperparameters : keyword arguments of the algorithm; what is not given is
        Stable-Baselines3's default, with the policy "MlpPolicy".
    normalise : any of "observations" and "rewards", by their running means and variances, for PPO and A2C. The
        policy that is saved takes observations as the environment gives them.
    exploration : standard deviation of each continuous action at the start of training, for PPO and A2C; by
        default Stable-Baselines3's `log_std_init` for all of them.
    fast : whether to compute observations at once (see `FastObservations`); they are the same.
    simulator : one of `SIMULATORS`. In the compiled copy of highway-env the model becomes the same, bit for
        bit; "auto" takes it where it serves. The manifest says which it was.
    shield : a profile of `ShieldConfig`, to learn inside the shield; or "none". What is learned from is what the policy
        asked for, whatever was driven. On straight highways with meta-actions "auto" takes `ShieldedVecEnv`, elsewhere
        `ShieldedEnv` around highway-env itself.
    sensor : through what the policy sees, as in `evaluation.wrappers.channels.split_sensor`; in highway-env itself on
        networks of roads, and inside a shield.
    envs : environments side by side, as many seeds from `seed` on.
    tensorboard : a folder to log to for TensorBoard, which the extra `tensorboard` installs.
    progress : whether to show a progress bar.
    command : the shell command that repeats this; by default one that calls this function.

    Returns
    -------
    The written file and its manifest.
    """
    algorithm = algorithm.lower()
    check_name("algorithm", algorithm, TRAINABLE)
    algorithm_class = get_algorithm(algorithm)
    setting = get_setting(setting) if isinstance(setting, str) else setting
    parameters = dict(hyperparameters or {})
    path = _check(steps, seed, output)

    if normalise and (algorithm not in _ON_POLICY or not set(normalise) <= set(NORMALISABLE)):
        raise ConfigError(
            f"{algorithm} cannot normalise {', '.join(normalise)}; {' and '.join(_ON_POLICY)} can normalise"
            f" {' and '.join(NORMALISABLE)}"
        )
    if envs < 1:
        raise ConfigError(f"envs must be 1 or more, not {envs}")
    if tensorboard is not None:
        _check_tensorboard()
        parameters_of_run: dict[str, Any] = {"tensorboard_log": str(tensorboard)}
    else:
        parameters_of_run = {}
    driven_in, env = _world(setting, simulator, fast, shield, sensor, envs)
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
            world = normalised(env, normalise, parameters.get("gamma", 0.99)) if normalise else env
            try:
                model = algorithm_class(**arguments, **parameters_of_run, env=world, seed=seed, device="cpu")
            except TypeError as error:
                raise ConfigError(f"{algorithm} takes no such hyperparameters: {error}") from None
            if exploration:
                _explore(model, exploration)
            model.learn(steps, progress_bar=progress)
            if "observations" in normalise:
                fold(model)
        seconds = time.perf_counter() - started
        path.parent.mkdir(parents=True, exist_ok=True)
        model.save(path)
    finally:
        env.close()

    options: dict[str, Any] = {"normalise": list(normalise), "exploration": list(exploration), "fast": fast}
    options = {name: value for name, value in options.items() if value}
    if envs != 1:
        options["envs"] = envs
    if simulator != "auto":
        options["simulator"] = simulator
    if shield != "none":
        options["shield"] = shield
    if sensor != "exact":
        options["sensor"] = sensor
    manifest = {
        "command": command or _call(setting, algorithm, steps, seed, parameters, path, options),
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
        **options,
        "simulator": driven_in,
        "training_seconds": round(seconds, 1),
        "versions": {"python": platform.python_version(), **{p: version(p) for p in _PACKAGES}},
    }
    manifest_path(path).write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
    return TrainedPolicy(path=path, manifest=manifest)


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
    output : the zip file to write instead.
    steps : training steps instead of the recipe's.
    simulator, sensor : as of `train`; a sensor only where the recipe has none itself.
    progress : whether to show a progress bar.
    """
    recipe = get_recipe(name)
    if sensor != "exact" and recipe.sensor != "exact":
        raise ConfigError(f"the recipe {name!r} has a sensor, {recipe.sensor!r}: it takes no other")
    steps = recipe.steps if steps is None else steps
    file = name if sensor == "exact" else f"{name}-{sensor}"
    more = "" if steps == recipe.steps else f" --steps {steps}"
    more += "" if sensor == "exact" else f" --sensor {sensor}"
    return train(
        recipe.setting,
        recipe.algorithm,
        steps,
        recipe.seed,
        hyperparameters=recipe.hyperparameters,
        normalise=recipe.normalise,
        exploration=recipe.exploration,
        fast=recipe.fast,
        simulator=simulator,
        shield=recipe.shield,
        sensor=recipe.sensor if sensor == "exact" else sensor,
        output=output if output is not None else Path("runs", "policies", f"{file}.zip"),
        progress=progress,
        command=f"shield train --recipe {name}{more}",
    )


def _check_tensorboard() -> None:
    """Raise where TensorBoard's writer is missing."""
    if find_spec("tensorboard") is None:
        raise ConfigError(
            "logging to TensorBoard needs the package tensorboard: pip install 'highway-shield[tensorboard]'"
        )


def _world(
    setting: Setting, simulator: str, fast: bool, shield: str, sensor: str, envs: int
) -> tuple[str, gym.Env[Any, Any] | VecEnv]:
    """The name of what simulates the environments to train in, and these, inside a shield of that profile or "none" and
    seen through a sensor."""

    def made() -> gym.Env[Any, Any]:
        env = setting.make()
        return seen_through(FastObservations(env) if fast else env, sensor)

    settings = None if shield == "none" else ShieldConfig.profile(shield)

    def compiled() -> tuple[gym.Env[Any, Any] | VecEnv, bool]:
        from evaluation.learning.fast_vec_env import FastHighwayVecEnv

        if settings is not None:
            return _shielded(setting, settings, sensor, envs)
        env = setting.make() if sensor != "exact" else made()
        if on_network(env.unwrapped):
            if sensor != "exact":
                raise ConfigError(f"the sensor {sensor!r} observes highway-env itself on this road")
            whole = _whole_episodes(setting, envs)
            if whole is not None:
                return whole
            frames = with_compiled_frames(env)
            return _several(lambda: with_compiled_frames(setting.make()), envs, frames), frames.exact
        if sensor != "exact":

            def alone() -> gym.Env[Any, Any]:
                return seen_through(CompiledHighwayEnv(setting.env_id, setting.configured), sensor)

            first = alone()
            return _several(alone, envs, first), cast(Any, first.unwrapped).simulator.exact
        world = FastHighwayVecEnv(envs, setting.env_id, setting.configured)
        return world, world.simulator.exact

    world = compiled_where_it_serves(simulator, compiled)
    if world is not None:
        return "compiled", world
    return "highway-env", _several(lambda: made() if settings is None else ShieldedEnv(made(), settings), envs)


def _several(
    make: Callable[[], gym.Env[Any, Any]], envs: int, first: gym.Env[Any, Any] | None = None
) -> gym.Env[Any, Any] | VecEnv:
    """One environment, or several side by side, `first` among them if it is given."""
    ready = [] if first is None else [first]

    def one() -> gym.Env[Any, Any]:
        return Monitor(ready.pop() if ready else make())

    return one() if envs == 1 else DummyVecEnv([one] * envs)


def _shielded(setting: Setting, settings: ShieldConfig, sensor: str, envs: int) -> tuple[VecEnv, bool]:
    """Compiled highways inside their shields, and whether these are exact."""
    from evaluation.learning.shielded_vec_env import ShieldedVecEnv

    if sensor != "exact":
        raise ConfigError(f"inside the shield the sensor {sensor!r} observes highway-env itself")
    world = ShieldedVecEnv(envs, setting.env_id, setting.configured, settings)
    return world, world.simulator.exact


def _whole_episodes(setting: Setting, envs: int) -> tuple[VecEnv, bool] | None:
    """Environments on a road network compiled altogether, and whether these are exact; None where only their frames are
    compiled."""
    from evaluation.learning.fast_road_vec_env import FastRoadVecEnv

    try:
        world = FastRoadVecEnv(envs, setting.env_id, setting.configured)
    except ConfigError:
        return None
    return world, world.simulator.exact


def _check(steps: int, seed: int, output: str | Path) -> Path:
    if steps <= 0:
        raise ConfigError(f"steps must be positive, not {steps}")
    if not 0 <= seed < FIRST_EVALUATION_SEED:
        raise ConfigError(
            f"training seeds are 0 to {FIRST_EVALUATION_SEED - 1}, not {seed}: the others are kept for evaluation"
        )
    path = Path(output)
    return path if path.suffix == ".zip" else path.with_name(path.name + ".zip")


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


def _call(
    setting: Setting,
    algorithm: str,
    steps: int,
    seed: int,
    parameters: dict[str, Any],
    path: Path,
    options: dict[str, Any],
) -> str:
    more = "".join(f", {name}={value!r}" for name, value in options.items())
    code = (
        "from evaluation.settings import Setting; from evaluation.learning.training import train; "
        f"train(Setting({setting.name!r}, {setting.env_id!r}, {dict(setting.config)!r}), "
        f"{algorithm!r}, {steps}, {seed}, hyperparameters={parameters!r}{more}, output={path.name!r})"
    )
    return f"python -c {shlex.quote(code)}"
