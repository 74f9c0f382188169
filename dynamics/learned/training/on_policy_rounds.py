"""Rounds of on-policy data: fit, drive with a policy made from the fit, fit again on all data.

A planner evaluates its model at states that random driving does not visit. A few hundred transitions of driving with
the planner add these states to the data.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from dynamics.errors import ConfigError
from dynamics.learned.data.collect import PredictingPolicy, collect
from dynamics.learned.data.transitions import Transitions
from dynamics.learned.models.linear import LinearStructuredModel, ModelConfig
from dynamics.learned.training.fit import Fit, FitConfig, fit
from dynamics.state import FloatArray

__all__ = ["Round", "RoundsConfig", "first_driving", "rounds"]


@dataclass(frozen=True, slots=True)
class RoundsConfig:
    """Amount of driving.

    Attributes
    ----------
    transitions : number with random actions, before the first fit.
    rounds : number of rounds of on-policy driving.
    per_round : transitions in each.
    episode_steps : longest episode with random actions; None for the environment's limit.
    on_policy_steps : longest on-policy episode; None for the environment's limit.
    hold : a random action is repeated for 1 to `hold` decisions.
    seed : of the whole collection; each round has a different seed derived from it.
    """

    transitions: int = 1000
    rounds: int = 2
    per_round: int = 400
    episode_steps: int | None = 50
    on_policy_steps: int | None = 50
    hold: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        if self.transitions < 1 or self.rounds < 0 or self.per_round < 1:
            raise ConfigError(
                f"transitions and per_round must be positive and rounds not negative, got {self.transitions}, "
                f"{self.per_round} and {self.rounds}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """Result of a round.

    Attributes
    ----------
    number : 0 for the round with random actions.
    data : all data collected so far.
    fit : the model fitted to it.
    """

    number: int
    data: Transitions
    fit: Fit


def rounds(
    env: Any,
    state: Callable[[Any], FloatArray],
    model: ModelConfig,
    policy_of: Callable[[LinearStructuredModel, Transitions], PredictingPolicy] | None,
    config: RoundsConfig | None = None,
    fit_config: FitConfig | None = None,
    *,
    progress: bool = False,
    tensorboard: str | None = None,
) -> Iterator[Round]:
    """Collect and fit, round by round; yields the result of each.

    The first fit starts from random weights, each later one from the weights before.

    Parameters
    ----------
    state : reads the model's state from an observation (see `dynamics.learned.data.collect.collect`).
    model : configuration of the model.
    policy_of : makes the policy of a round from the model and the data so far; None if there are no rounds.
    tensorboard : folder for TensorBoard's event files, with one folder for each round.

    Raises
    ------
    ConfigError
        If there are rounds and no `policy_of`.
    DataError, ModelError
        As `collect` and `fit` do.
    """
    config = config or RoundsConfig()
    if config.rounds and policy_of is None:
        raise ConfigError("on-policy rounds need policy_of, which makes a policy from a model")
    data = first_driving(env, state, model.dt, config)
    start: ModelConfig | LinearStructuredModel = model
    for number in range(config.rounds + 1):
        if number:
            assert policy_of is not None
            assert isinstance(start, LinearStructuredModel)
            driver = policy_of(start, data)
            data = data + collect(
                env,
                driver,
                config.per_round,
                _seed(config, number),
                state=state,
                dt=model.dt,
                episode_steps=config.on_policy_steps,
            )
        folder = None if tensorboard is None else f"{tensorboard}/round-{number}"
        done = fit(data, start, fit_config, progress=progress, tensorboard=folder)
        yield Round(number, data, done)
        start = done.model


def first_driving(env: Any, state: Callable[[Any], FloatArray], dt: float, config: RoundsConfig) -> Transitions:
    """The random driving of round 0. Parameters and errors as in `rounds`; `dt` is the duration of a decision [s]."""
    return collect(
        env,
        None,
        config.transitions,
        _seed(config, 0),
        state=state,
        dt=dt,
        episode_steps=config.episode_steps,
        hold=config.hold,
    )


def _seed(config: RoundsConfig, number: int) -> int:
    return 1000 * config.seed + number
