"""Transitions from an environment under any policy, with a separate random generator."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any, Protocol

import numpy as np
from gymnasium import spaces

from dynamics.errors import ConfigError, DataError
from dynamics.learned.data.transitions import Transitions
from dynamics.state import FloatArray

__all__ = ["RESET_SEEDS", "PredictingPolicy", "RepeatedRandomPolicy", "collect"]

RESET_SEEDS = 10_000
"""Bound on the seeds of resets; evaluation uses other seeds."""


class PredictingPolicy(Protocol):
    """A policy as in Stable-Baselines3."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """The action and the policy's next state."""
        ...


class RepeatedRandomPolicy:
    """Uniform actions from a separate generator, each repeated for a random number of decisions.

    Parameters
    ----------
    space : a bounded Box, or Discrete.
    generator : source of the random numbers. `env.action_space` is none: highway-env makes a new, unseeded one at each
        reset.
    hold : an action is repeated for 1 to `hold` decisions; 1 draws a new one each time.
    """

    def __init__(self, space: spaces.Space[Any], generator: np.random.Generator, hold: int = 1) -> None:
        if not isinstance(space, spaces.Box | spaces.Discrete):
            raise ConfigError(f"random actions are drawn from a Box or Discrete space, not from {type(space).__name__}")
        if hold < 1:
            raise ConfigError(f"hold must be 1 or more decisions, got {hold}")
        self._space, self._generator, self._hold = space, generator, hold
        self._left, self._action = 0, None

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """A random action; the observation is not read."""
        if self._left == 0 or (episode_start is not None and np.any(episode_start)):
            self._left = int(self._generator.integers(1, self._hold + 1))
            self._action = self._draw()
        self._left -= 1
        return self._action, None

    def _draw(self) -> Any:
        space = self._space
        if isinstance(space, spaces.Discrete):
            return int(space.start + self._generator.integers(space.n))
        return self._generator.uniform(space.low, space.high).astype(space.dtype)


def collect(
    env: Any,
    policy: PredictingPolicy | None = None,
    transitions: int = 1000,
    seed: int = 0,
    *,
    state: Callable[[Any], FloatArray],
    dt: float,
    episode_steps: int | None = None,
    hold: int = 1,
) -> Transitions:
    """Drive and record.

    The last transition of an episode that terminated (a crash, a success) is left out, since the effect of a crash on
    the state is no dynamics. If the episode was truncated by the time limit or by `episode_steps`, it is kept.

    Parameters
    ----------
    env : any Gymnasium environment with a bounded Box or a Discrete action space.
    policy : None for random actions.
    transitions : number to record.
    seed : of the generator for resets and random actions. The same seed gives the same data.
    state : the state (d,) in the model's units, read from an observation (for parking-v0
        `dynamics.learned.tasks.parking_state.state`).
    dt : duration of a decision [s].
    episode_steps : greatest number of decisions of an episode; None for the environment's limit.
    hold : a random action is repeated for 1 to `hold` decisions.

    Raises
    ------
    ConfigError
        If the action space or a number is not supported.
    DataError
        If an observation cannot be read, a state is not finite, or every episode ends at once.
    """
    if transitions < 1 or (episode_steps is not None and episode_steps < 1):
        raise ConfigError(f"transitions and episode_steps must be positive, got {transitions} and {episode_steps}")
    space = env.action_space
    encode = _encoder(space)
    generator = np.random.default_rng(seed)
    driver = RepeatedRandomPolicy(space, generator, hold) if policy is None else policy
    rows: list[tuple[FloatArray, FloatArray, FloatArray, int]] = []
    episode = fruitless = 0
    while len(rows) < transitions:
        observation, _ = env.reset(seed=int(generator.integers(RESET_SEEDS)))
        most = transitions - len(rows)
        found = list(islice(_episode(env, driver, observation, state, encode, episode_steps), most))
        rows += [(*row, episode) for row in found]
        episode += 1
        fruitless = 0 if found else fruitless + 1
        if fruitless == 100:
            raise DataError("100 episodes in a row ended at their first decision: there is nothing to learn from")
    origin = {
        "seed": seed,
        "policy": type(driver).__name__,
        "environment": getattr(getattr(env, "spec", None), "id", type(env).__name__),
        "terminal": "dropped",
    }
    states, actions, after, episodes = (np.array(column) for column in zip(*rows, strict=True))
    return Transitions(states, actions, after, episodes, dt, origin)


def _episode(
    env: Any,
    driver: PredictingPolicy,
    observation: Any,
    state: Callable[[Any], FloatArray],
    encode: Callable[[Any], FloatArray],
    episode_steps: int | None,
) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
    """State, encoded action and next state of each decision of an episode that begins with an observation. The decision
    that terminates the episode is left out."""
    now, memory, done, steps = state(observation), None, False, 0
    while not done:
        start = np.array([steps == 0])
        action, memory = driver.predict(observation, state=memory, episode_start=start, deterministic=True)
        observation, _, terminated, truncated, _ = env.step(action)
        steps += 1
        done = terminated or truncated or steps == episode_steps
        after = state(observation)
        if not terminated:
            yield now, encode(action), after
        now = after


def _encoder(space: spaces.Space[Any]) -> Callable[[Any], FloatArray]:
    """A function from actions to rows in [-1, 1]: actions of a Box scaled by its bounds and clipped, discrete ones
    one-hot."""
    if isinstance(space, spaces.Discrete):
        identity = np.eye(int(space.n))
        return lambda action: identity[int(action) - int(space.start)]
    if isinstance(space, spaces.Box) and len(space.shape) == 1 and space.is_bounded():
        low, high = space.low.astype(float), space.high.astype(float)
        return lambda action: np.clip(2 * (np.asarray(action, dtype=float) - low) / (high - low) - 1, -1.0, 1.0)
    raise ConfigError(f"the action space must be Discrete or a bounded Box with one axis, got {space}")
