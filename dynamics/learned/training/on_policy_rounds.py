"""Rounds of on-policy data: fit, drive with a policy made from the fit, fit again on everything.

A model that was fitted to random driving is asked by its planner about states that random driving never sees. A few
hundred transitions of the planner's own driving tell it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from dynamics.errors import ConfigError
from dynamics.learned.data.collect import Predicts, collect
from dynamics.learned.data.transitions import Transitions
from dynamics.learned.models.linear import LinearStructuredModel, ModelConfig
from dynamics.learned.training.fit import Fit, FitConfig, fit
from dynamics.state import FloatArray

__all__ = ["Round", "RoundsConfig", "first_driving", "rounds"]


@dataclass(frozen=True, slots=True)
class RoundsConfig:
    """How much is driven.

    Attributes
    ----------
    transitions : with random actions, before the first fit.
    rounds : of on-policy driving.
    per_round : transitions in each.
    episode_steps : longest episode with random actions; None leaves it to the environment.
    on_policy_steps : longest episode on-policy.
    hold : a random action is held for 1 to `hold` decisions.
    seed : of all collecting; each round has numbers of its own.
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
    """State after a round.

    Attributes
    ----------
    number : 0 is the one with random actions.
    data : everything collected so far.
    fit : the model fitted to it.
    """

    number: int
    data: Transitions
    fit: Fit


def rounds(
    env: Any,
    state: Callable[[Any], FloatArray],
    model: ModelConfig,
    policy_of: Callable[[LinearStructuredModel, Transitions], Predicts] | None,
    config: RoundsConfig | None = None,
    fit_config: FitConfig | None = None,
    *,
    progress: bool = False,
    tensorboard: str | None = None,
) -> Iterator[Round]:
    """Collect and fit, round after round; each is yielded when it is done.

    The first fit starts anew, the later ones from the weights before.

    Parameters
    ----------
    state : reads the model's state from an observation (see `dynamics.learned.data.collect.collect`).
    policy_of : makes the driver of a round from the model and the data so far; None if there are no rounds.
    tensorboard : folder for TensorBoard's event files, one below it for each round.

    Raises
    ------
    ConfigError
        If there are rounds and nobody to drive.
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
