"""The planner `cem` over meta-actions in `roundabout`: training of its models, and the policy."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from time import perf_counter
from typing import Any

import gymnasium as gym

from dynamics.learned.data.transitions import Transitions
from dynamics.learned.models.files import load_model, save_model
from dynamics.learned.models.linear import LinearStructuredModel
from dynamics.learned.tasks.roundabout_model import RoundaboutModel, collect_roundabout, roundabout_config
from dynamics.learned.training.fit import FitConfig, fit
from evaluation.settings import get_setting
from mpc.cem_policy import CEMPolicy
from mpc.tasks.roundabout import RoundaboutTask
from shield.errors import ConfigError

__all__ = ["load_roundabout", "roundabout_policy", "train_roundabout"]

_FOLDER = Path(__file__).parent.parent / "policies"
_NAMES = ("cem-roundabout-ego", "cem-roundabout-others")
_FIT = {"epochs": 100, "horizon": 1}
_RANDOM, _ON_POLICY = 900, 500
_SPEEDS = (0.0, 8.0, 16.0)


def train_roundabout(
    seed: int = 0, folder: str | Path | None = None, progress: bool = False
) -> tuple[LinearStructuredModel, LinearStructuredModel]:
    """Collect 900 random and 500 on-policy decisions in the roundabout; fit the models of the ego and of the others.

    Parameters
    ----------
    seed : seed of all random numbers; episodes are reset with seeds below 10,000.
    folder : where to write the two models; None to write nothing.
    progress : whether to show bars.
    """
    begin = perf_counter()
    env, first = get_setting("roundabout").make(), 1000 * (seed % 8)
    data = collect_roundabout(env, _RANDOM, seed, first_reset=first)
    models = _fit(data, seed, progress)
    driver = _driver(env, *models)
    more = collect_roundabout(env, _ON_POLICY, seed + 1, driver, explore=0.3, first_reset=first + 500)
    both = (data[0] + more[0], data[1] + more[1])
    models = _fit(both, seed, progress)
    env.close()
    if folder is not None:
        notes = {"seconds": round(perf_counter() - begin, 1), "seed": seed}
        for name, model, part in zip(_NAMES, models, both, strict=True):
            save_model(model, Path(folder) / name, {**notes, "motions": len(part)})
    return models


def _fit(
    data: tuple[Transitions, Transitions], seed: int, progress: bool
) -> tuple[LinearStructuredModel, LinearStructuredModel]:
    settings = FitConfig(seed=seed, **_FIT)  # type: ignore[arg-type]
    ego, others = (
        fit(part, roundabout_config(part.actions.shape[1], part.dt, seed), settings, progress=progress).model
        for part in data
    )
    return ego, others


@lru_cache(maxsize=4)
def load_roundabout(folder: str | Path = _FOLDER) -> tuple[LinearStructuredModel, LinearStructuredModel]:
    """Load the models of the ego and of the others; the bundled ones by default."""
    ego, others = (load_model(Path(folder) / name) for name in _NAMES)
    return ego, others


def roundabout_policy(env: gym.Env[Any, Any], folder: str | Path = _FOLDER) -> CEMPolicy:
    """The planner for highway-env's roundabout.

    Raises
    ------
    ConfigError
        If the environment's meta-actions differ from those in the models' training.
    """
    base: Any = env.unwrapped
    speeds = tuple(float(v) for v in getattr(base.action_type, "target_speeds", ()))
    period = float(base.config["policy_frequency"])
    if speeds != _SPEEDS or period != 1.0:
        raise ConfigError(
            f"the planner's models know target speeds {_SPEEDS} at 1 Hz (have roundabout); this environment has "
            f"{speeds} at {period:g} Hz"
        )
    return _driver(env, *load_roundabout(folder))


def _driver(env: gym.Env[Any, Any], ego: LinearStructuredModel, others: LinearStructuredModel) -> CEMPolicy:
    task = RoundaboutTask(env)
    return CEMPolicy.roundabout(env, RoundaboutModel(ego, others, task.rows, task.exit_arm), task=task)
