"""The planner `cem` over meta-actions on a highway: training of its model, and the policy."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from time import perf_counter
from typing import Any

import gymnasium as gym

from dynamics.learned.models.files import load_model, save_model
from dynamics.learned.models.linear import LinearStructuredModel
from dynamics.learned.tasks.traffic_model import TrafficModel, collect_traffic, traffic_config
from dynamics.learned.training.fit import FitConfig, fit
from evaluation.settings import get_setting
from mpc.cem_policy import CEMPolicy
from shield.errors import ConfigError

__all__ = ["highway_policy", "load_traffic", "train_traffic"]

_FOLDER = Path(__file__).parent.parent / "policies" / "cem-highway"
_FIT = {"epochs": 60, "horizon": 3, "finish_epochs": 15}
_SPEEDS = (20.0, 25.0, 30.0)


def train_traffic(seed: int = 0, folder: str | Path | None = None, progress: bool = False) -> LinearStructuredModel:
    """Collect 600 random and 300 on-policy decisions in highway-fast, and fit the model of a pair of vehicles.

    Parameters
    ----------
    seed : seed of all random numbers; episodes are reset with seeds below 10,000.
    folder : where to write the model; None to write nothing.
    progress : whether to show bars.
    """
    begin = perf_counter()
    env, settings = get_setting("highway-fast").make(), FitConfig(seed=seed, **_FIT)  # type: ignore[arg-type]
    first = 1000 * (seed % 8)
    data = collect_traffic(env, 600, seed, first_reset=first)
    config = traffic_config(int(env.action_space.n), data.dt, seed)  # type: ignore[attr-defined]
    model = fit(data, config, settings, progress=progress).model
    driver = CEMPolicy.highway(env, TrafficModel(model, env.observation_space.shape[0] - 1))  # type: ignore[index]
    data = data + collect_traffic(env, 300, seed + 1, driver, explore=0.3, first_reset=first + 500)
    model = fit(data, config, settings, progress=progress).model
    env.close()
    if folder is not None:
        save_model(model, folder, {"pairs": len(data), "seconds": round(perf_counter() - begin, 1), "seed": seed})
    return model


@lru_cache(maxsize=4)
def load_traffic(folder: str | Path = _FOLDER) -> LinearStructuredModel:
    """Load the model of a pair of vehicles; the bundled one by default."""
    return load_model(folder)


def highway_policy(env: gym.Env[Any, Any], folder: str | Path = _FOLDER) -> CEMPolicy:
    """The planner for an environment like highway-fast.

    Raises
    ------
    ConfigError
        If the environment's meta-actions or observations differ from those in the model's training.
    """
    base: Any = env.unwrapped
    kind = type(base.action_type).__name__
    speeds = tuple(float(v) for v in getattr(base.action_type, "target_speeds", ()))
    period = float(base.config["policy_frequency"])
    if kind != "DiscreteMetaAction" or speeds != _SPEEDS or period != 1.0:
        raise ConfigError(
            f"the planner's model knows DiscreteMetaAction with target speeds {_SPEEDS} at 1 Hz (have highway-fast, "
            f"highway), or parking; this environment has {kind} with {speeds} at {period:g} Hz"
        )
    shape = env.observation_space.shape
    if shape is None or len(shape) != 2:
        raise ConfigError(f"the planner needs Kinematics observations, this environment has {env.observation_space}")
    return CEMPolicy.highway(env, TrafficModel(load_traffic(folder), shape[0] - 1))
