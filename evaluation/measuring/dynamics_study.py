"""Study of prediction errors: how well models of the dynamics predict, and the effect of each part of the training.

Every model has the same two open-loop tests: random driving, and on-policy driving of a planner with on-policy rounds.
Test data come from separate episodes, which no model was fitted to.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import pandas as pd

from dynamics.errors import ConfigError
from dynamics.learned.data.collect import PredictingPolicy, collect
from dynamics.learned.data.transitions import Transitions
from dynamics.learned.models.bicycle import BicycleModel
from dynamics.learned.models.files import load_model
from dynamics.learned.models.linear import LinearStructuredModel
from dynamics.learned.models.model import DynamicsModel
from dynamics.learned.tasks import parking_state as parking
from dynamics.learned.training.distill import distill
from dynamics.learned.training.fit import Fit, fit
from dynamics.learned.training.on_policy_rounds import Round, RoundsConfig, first_driving, rounds
from dynamics.learned.training.open_loop import OpenLoop, open_loop
from dynamics.learned.training.variants import DEFAULT, VARIANTS, LearningVariant, variant

__all__ = [
    "ENVIRONMENTS",
    "HORIZON",
    "TEST",
    "TRUTH",
    "ModelTest",
    "TimedRound",
    "errors",
    "fresh_driving",
    "learn",
    "stored",
    "study",
]

ENVIRONMENTS = ("parking-v0",)
"""Environments with learned dynamics."""
HORIZON = 15
"""Number of decisions of an open-loop prediction."""
TEST = 600
"""Number of test transitions of each of the two kinds of driving."""

TRUTH = "true bicycle"
"""Name of the result for the simulator's own bicycle model."""

_TEST_SEED = 900_000
"""First seed of test driving, apart from those of training."""


@dataclass(frozen=True, slots=True, eq=False)
class TimedRound:
    """A round of learning, with its times [s]: driving (with planning and distilling), and fitting."""

    round: Round
    driving: float
    fitting: float


@dataclass(frozen=True, slots=True, eq=False)
class ModelTest:
    """Test result of a model.

    Attributes
    ----------
    name, seed : name of the model, and seed of its training.
    transitions : number of transitions in its data.
    seconds : time of fitting alone [s].
    random, on_policy : open-loop errors in both kinds of driving.
    """

    name: str
    seed: int
    transitions: int
    seconds: float
    random: OpenLoop
    on_policy: OpenLoop


def driver(env: Any) -> Callable[[LinearStructuredModel, Transitions], PredictingPolicy]:
    """A function that makes the driver of on-policy rounds.

    The driver plans with the macro-steps of the model, or with the model itself if its form has no macro-steps.
    """
    from mpc.cem_policy import CEMPolicy

    def make(model: LinearStructuredModel, data: Transitions) -> PredictingPolicy:
        return CEMPolicy.parking(env, distill(model, data) if model.config.form == "body" else model)

    return make


def learn(
    setup: LearningVariant, env_id: str = "parking-v0", progress: bool = False, tensorboard: str | None = None
) -> Iterator[TimedRound]:
    """Collect data and fit models as a variant specifies, and yield each round as `TimedRound`.

    Raises
    ------
    ConfigError
        If the environment is not in `ENVIRONMENTS`.
    """
    env = _make(env_id)
    try:
        # The planner reads the spaces of the environment, which exist after the first reset.
        env.reset(seed=0)
        done = rounds(
            env,
            parking.state,
            setup.model,
            driver(env),
            setup.data,
            setup.fit,
            progress=progress,
            tensorboard=tensorboard,
        )
        begin = perf_counter()
        for each in done:
            yield TimedRound(each, perf_counter() - begin - each.fit.seconds, each.fit.seconds)
            begin = perf_counter()
    finally:
        env.close()


def fresh_driving(
    model: LinearStructuredModel, data: Transitions, seed: int, transitions: int = TEST, env_id: str = "parking-v0"
) -> tuple[Transitions, Transitions]:
    """New random and on-policy driving; the planner uses `model`, trained on `data`."""
    env = _make(env_id)
    try:
        env.reset(seed=0)
        options: Any = {"state": parking.state, "dt": parking.DT, "episode_steps": 50}
        random = collect(env, None, transitions, _TEST_SEED + 2 * seed, **options)
        on_policy = collect(env, driver(env)(model, data), transitions, _TEST_SEED + 2 * seed + 1, **options)
    finally:
        env.close()
    return random, on_policy


def model_test(name: str, seed: int, model: DynamicsModel, transitions: int, seconds: float, tests: Any) -> ModelTest:
    """Open-loop errors of a model in both kinds of driving."""
    random, on_policy = (open_loop(model, part, HORIZON) for part in tests)
    return ModelTest(name, seed, transitions, seconds, random, on_policy)


def study(
    names: Sequence[str] = tuple(VARIANTS),
    seeds: Iterable[int] = (0,),
    env_id: str = "parking-v0",
    transitions: int = TEST,
    progress: Callable[[str], None] = lambda line: None,
) -> Iterator[list[ModelTest]]:
    """Train variants and test them, seed after seed; the last result of each seed is the true bicycle's.

    Raises
    ------
    ConfigError
        If a variant or the environment is unknown.
    """
    setups = {name: variant(name) for name in names}
    for seed in seeds:
        out: list[ModelTest] = []
        progress(f"seed {seed}: {DEFAULT}, and test driving")
        default = variant(DEFAULT).seeded(seed)
        learned = [timed.round for timed in learn(default, env_id)]
        tests = fresh_driving(learned[-1].fit.model, learned[-1].data, seed, transitions, env_id)
        random_data: dict[RoundsConfig, Transitions] = {replace(default.data, rounds=0): learned[0].data}
        for name, setup in setups.items():
            progress(f"seed {seed}: {name}")
            fitted, count = _learned(setup.seeded(seed), default, learned, random_data, env_id)
            out.append(model_test(name, seed, fitted.model, count, fitted.seconds, tests))
        out.append(model_test(TRUTH, seed, BicycleModel(), 0, 0.0, tests))
        yield out


def _learned(
    setup: LearningVariant,
    default: LearningVariant,
    rounds_done: Sequence[Round],
    driven: dict[RoundsConfig, Transitions],
    env_id: str,
) -> tuple[Fit, int]:
    """The last fit of a variant and the size of its data; earlier rounds and data are reused."""
    number = setup.data.rounds
    if (setup.model, setup.fit, replace(setup.data, rounds=0)) == (
        default.model,
        default.fit,
        replace(default.data, rounds=0),
    ) and number < len(rounds_done):
        return rounds_done[number].fit, len(rounds_done[number].data)
    if number:
        *_, last = learn(setup, env_id)
        return last.round.fit, len(last.round.data)
    key = replace(setup.data, rounds=0, per_round=default.data.per_round)
    if key not in driven:
        env = _make(env_id)
        driven[key] = first_driving(env, parking.state, setup.model.dt, setup.data)
        env.close()
    return fit(driven[key], setup.model, setup.fit), len(driven[key])


def stored(folders: Mapping[str, Path], data_file: str, env_id: str, transitions: int = TEST) -> list[ModelTest]:
    """Test saved models, each in driving of its own; `data_file` in its folder has the data of its planner's range.

    Raises
    ------
    ModelError, DataError
        If a model or its data cannot be read.
    """
    out = []
    for name, folder in folders.items():
        model, data = load_model(folder), Transitions.load(folder / data_file)
        out.append(model_test(name, 0, model, len(data), 0.0, fresh_driving(model, data, 0, transitions, env_id)))
    return out


def errors(trials: Sequence[ModelTest]) -> pd.DataFrame:
    """One row for each result: position errors [m] after 1 and `HORIZON` decisions, medians and 95 % quantiles."""
    rows = []
    for each in trials:
        row: dict[str, Any] = {"model": each.name, "seed": each.seed, "transitions": each.transitions}
        row["fit_seconds"] = each.seconds
        for kind, loop in (("random", each.random), ("on_policy", each.on_policy)):
            for step in (1, HORIZON):
                row[f"{kind}_{step}"] = loop.median[step - 1]
                row[f"{kind}_{step}_p95"] = loop.quantile(0.95)[step - 1]
        rows.append(row)
    return pd.DataFrame(rows)


def _make(env_id: str) -> gym.Env[Any, Any]:
    if env_id not in ENVIRONMENTS:
        raise ConfigError(f"dynamics can be learned in {', '.join(ENVIRONMENTS)}, not in {env_id!r}")
    return gym.make(env_id)
