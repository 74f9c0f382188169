"""Learned models of throttle and steering on a highway, by setting: collection, training, evaluation and loading.

A model belongs to one simulation frequency and a number of frames under one input. A setting has a model of 0.2 s, the
stage of the predictive filter. Where its frames are shorter, it has a second one of a single frame. Each model is a
folder "driving-FREQUENCYhz-FRAMES".
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from time import process_time
from typing import Any

import gymnasium as gym
import numpy as np

from dynamics.errors import ModelError
from dynamics.learned.data.collect import PredictingPolicy, collect
from dynamics.learned.data.transitions import Transitions
from dynamics.learned.models.casadi_steps import LearnedStep, LearnedSteps, actuator_notes
from dynamics.learned.models.files import save_model
from dynamics.learned.models.linear import LinearStructuredModel, ModelConfig
from dynamics.learned.models.model import DynamicsModel
from dynamics.learned.tasks.driving_state import OBSERVATION, RandomDriver, state
from dynamics.learned.training.fit import FitConfig, fit
from dynamics.learned.training.open_loop import OpenLoop, open_loop
from dynamics.vehicle.actuators import Actuators
from evaluation.names import MODELS, check_name
from evaluation.settings import Setting, get_setting
from shield.errors import ConfigError

__all__ = [
    "BRAKING",
    "BUNDLED",
    "MODELS",
    "STAGE",
    "TRANSITIONS",
    "TrainedDrivingModel",
    "collect_driving",
    "driving_model",
    "load_driving",
    "measure",
    "train_driving",
]

STAGE = 0.2
"""Duration of a decision of the model with several frames [s]."""
BRAKING = -10.0
"""Least acceleration in the data [m/s^2]: the shield's filter plans with 9.8 (`ShieldConfig.braking`)."""

BUNDLED = Path(__file__).parent.parent / "policies"
"""Folder of the bundled models."""
TRANSITIONS = 4000
"""Default number of random decisions in the data of a model."""
_EPISODE, _HOLD = 10.0, 5
"""Longest episode [s], and the largest number of decisions with the same input."""
_HORIZON = 15
_TOP = 38.0
"""Greatest speed at the start of an episode [m/s]."""
_FIT = {"epochs": 500, "horizon": 5, "finish_epochs": 30, "patience": 40}
_HIDDEN = (16, 16)


@dataclass(frozen=True, slots=True, eq=False)
class TrainedDrivingModel:
    """A trained model, its data, and the processor time of collection and training [s].

    Attributes
    ----------
    model : the model.
    data : its training data.
    actuators : actuators of its actions.
    frequency : simulation frequency [Hz].
    frames : simulation frames under one input.
    seconds : processor time [s].
    """

    model: LinearStructuredModel
    data: Transitions
    actuators: Actuators
    frequency: int
    frames: int
    seconds: float

    @property
    def name(self) -> str:
        """Name of the model's folder."""
        return _name(self.frequency, self.frames)


class _AnySpeed(gym.Wrapper[Any, Any, Any, Any]):
    """Starts episodes at a random speed between 0 and `_TOP`."""

    def __init__(self, env: gym.Env[Any, Any], generator: np.random.Generator) -> None:
        super().__init__(env)
        self._generator = generator

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset, and draw another speed."""
        _, info = self.env.reset(seed=seed, options=options)
        base: Any = self.env.unwrapped
        base.vehicle.speed = float(self._generator.uniform(0.0, _TOP))
        return base.observation_type.observe(), info


def collect_driving(
    setting: str | Setting,
    frames: int,
    transitions: int = TRANSITIONS,
    seed: int = 0,
    policy: type[Any] | None = None,
) -> tuple[Transitions, Actuators]:
    """Collect transitions of driving, with `frames` simulation frames under each input.

    Parameters
    ----------
    setting : the road and the simulation frequency; with `ContinuousAction`.
    frames : simulation frames under each input.
    transitions, seed : as in `dynamics.learned.data.collect.collect`.
    policy : class of a policy that is made with the environment. It drives among the setting's traffic, from the
        setting's starts and with its throttle. Without a policy there is no traffic, starts are at any speed, and
        inputs are random, down to `BRAKING`.

    Raises
    ------
    ConfigError
        If the setting has other actions.
    """
    setting = get_setting(setting) if isinstance(setting, str) else setting
    frequency = _frequency(setting)
    change: dict[str, Any] = {
        "observation": dict(OBSERVATION),
        "policy_frequency": frequency / frames,
        "duration": 1e6,
        "offroad_terminal": False,
    }
    if policy is None:
        kind = dict(setting.configured["action"])
        top = float(kind.get("acceleration_range", (-5.0, 5.0))[1])
        change |= {"vehicles_count": 0, "action": {**kind, "acceleration_range": [BRAKING, top]}}
    env = setting.override(change).make()
    dt = frames / frequency
    try:
        env.reset(seed=0)
        actuators = Actuators.of(env.unwrapped.action_type)  # type: ignore[attr-defined]
        driver: PredictingPolicy
        world: gym.Env[Any, Any] = env
        if policy is None:
            generator = np.random.default_rng([seed, 1])
            driver, world = RandomDriver(actuators, dt, generator, hold=_HOLD), _AnySpeed(env, generator)
        else:
            driver = policy(env)
        steps = round(_EPISODE / dt)
        data = collect(world, driver, transitions, seed, state=state, dt=dt, episode_steps=steps)
    finally:
        env.close()
    return data, actuators


def train_driving(
    setting: str = "highway-fast-continuous",
    seed: int = 0,
    folder: str | Path | None = None,
    transitions: int = TRANSITIONS,
    progress: bool = False,
) -> Iterator[TrainedDrivingModel]:
    """Collect random driving and fit the models of a setting, one after the other.

    Parameters
    ----------
    setting : a setting with `ContinuousAction`, throttle and steering.
    seed : seed of all random numbers; episodes are reset with seeds below 10,000.
    folder : where to write a folder for each model; None to write nothing.
    transitions : number of random decisions in the data.
    progress : whether to show bars.

    Raises
    ------
    ConfigError
        If the setting has other actions, or `STAGE` is no whole number of its frames.
    """
    frequency = _frequency(get_setting(setting))
    longest = round(STAGE * frequency)
    if abs(longest - STAGE * frequency) > 1e-9:
        raise ConfigError(f"{setting} has {frequency} frames a second, which do not make up {STAGE} s")
    for frames in sorted({1, longest}):
        begin = process_time()
        data, actuators = collect_driving(setting, frames, transitions, seed)
        config = ModelConfig(dt=data.dt, hidden=_HIDDEN, members=1, seed=seed)
        model = fit(data, config, FitConfig(seed=seed, **_FIT), progress=progress).model  # type: ignore[arg-type]
        trained = TrainedDrivingModel(model, data, actuators, frequency, frames, process_time() - begin)
        if folder is not None:
            notes = {"setting": setting, "transitions": len(data), "seed": seed, "cpu": round(trained.seconds, 1)}
            save_model(model, Path(folder, trained.name), {**notes, **actuator_notes(actuators)})
        yield trained


def measure(
    model: DynamicsModel,
    setting: str,
    frames: int,
    actuators: Actuators,
    transitions: int = 600,
    policy: type[Any] | None = None,
) -> OpenLoop:
    """Open-loop position error [m] after 1 to 15 decisions, in new data (see `collect_driving`).

    `actuators` are those of the model's actions; actions of another throttle are converted to them.
    """
    data, driven = collect_driving(setting, frames, transitions, 900_001, policy)
    if driven != actuators:
        data = replace(data, actions=actuators.normalised(driven.physical(data.actions)))
    return open_loop(model, data, _HORIZON)


def load_driving(frequency: int, root: str | Path = BUNDLED) -> LearnedSteps:
    """Load the models for a simulation frequency [Hz] from a folder; the bundled ones by default.

    Raises
    ------
    ModelError
        If there is no such model, or a file cannot be read.
    """
    folders = sorted(Path(root).glob(f"driving-{frequency}hz-*"))
    if not folders:
        have = ", ".join(sorted(path.name for path in Path(root).glob("driving-*hz-*"))) or "none"
        raise ModelError(
            f"{root} has no model of driving at {frequency} simulation frames a second; have {have}. "
            "`shield dynamics fit --setting SETTING --output FOLDER` makes them; give --model FOLDER"
        )
    return LearnedSteps(*(LearnedStep.load(folder) for folder in folders))


_bundled = lru_cache(maxsize=4)(load_driving)


def driving_model(name: str | None, env: Any) -> LearnedSteps | None:
    """Dynamics model of the predictive filter in an environment.

    Parameters
    ----------
    name : one of `MODELS`, or a folder that `shield dynamics fit --setting` wrote; None for the bicycle.

    Raises
    ------
    ConfigError
        If there is no such name or folder.
    ModelError
        If there is no model for the environment's simulation frequency.
    """
    if name is None or name == "bicycle":
        return None
    frequency = int(env.unwrapped.config["simulation_frequency"])
    if name == "learned":
        return _bundled(frequency)
    if not Path(name).is_dir():
        check_name("model", name, MODELS, ", or the folder of learned models")
    return load_driving(frequency, name)


def _frequency(setting: Setting) -> int:
    """Simulation frequency of a setting [Hz]; raises `ConfigError` for other actions than throttle and steering."""
    env = setting.make()
    try:
        base: Any = env.unwrapped
        kind = type(base.action_type).__name__
        if kind != "ContinuousAction" or not (base.action_type.longitudinal and base.action_type.lateral):
            raise ConfigError(
                f"driving is learned from throttle and steering; {setting.name} has {kind}. Have "
                "highway-fast-continuous and highway-continuous"
            )
        return int(base.config["simulation_frequency"])
    finally:
        env.close()


def _name(frequency: int, frames: int) -> str:
    return f"driving-{frequency}hz-{frames}"
