"""One policy in many environments side by side: actions that are known beforehand, and those of a model."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dynamics.state import IntArray
from evaluation.running.named_policies import ConstantPolicy, RandomPolicy, WeavingPolicy
from shield.wrappers.ranking import normalised, orders_from_scores, ranking_of

__all__ = ["Blind", "Drivers", "ModelDrivers", "Planned"]


class Drivers(Protocol):
    """One policy in every environment."""

    def begin(self, e: int, seed: int) -> None:
        """An episode begins in environment `e`."""

    def act(self, observations: NDArray[np.float32], steps: IntArray) -> tuple[IntArray, IntArray | None]:
        """The action of each (e,), and the order of preference over the others, or None; `steps` (e,) is how many
        decisions each episode has had."""


class Blind:
    """Policies whose actions are known when the episode begins, (steps,)."""

    def __init__(self, policy: ConstantPolicy | RandomPolicy | WeavingPolicy, envs: int, steps: int) -> None:
        self._policy, self._actions = policy, np.zeros((envs, steps), np.intp)

    def begin(self, e: int, seed: int) -> None:
        """Draw all of them."""
        self._actions[e] = self._policy.plan(seed, self._actions.shape[1])

    def act(self, observations: NDArray[np.float32], steps: IntArray) -> tuple[IntArray, IntArray | None]:
        """The next of each."""
        return self._actions[np.arange(len(steps)), steps], None


class Planned:
    """Actions that somebody has chosen, (e, steps)."""

    def __init__(self, actions: IntArray) -> None:
        self._actions = actions

    def begin(self, e: int, seed: int) -> None:
        """They are there."""

    def act(self, observations: NDArray[np.float32], steps: IntArray) -> tuple[IntArray, IntArray | None]:
        """The next of each."""
        return self._actions[np.arange(len(steps)), np.minimum(steps, self._actions.shape[1] - 1)], None


class ModelDrivers:
    """An SB3 model, asked about all observations at once."""

    def __init__(self, model: Any) -> None:
        self._model = model

    def begin(self, e: int, seed: int) -> None:
        """It is the same in every episode."""

    def act(self, observations: NDArray[np.float32], steps: IntArray) -> tuple[IntArray, IntArray | None]:
        """Its actions, and its order of preference by their scores."""
        actions = np.asarray(self._model.predict(observations, deterministic=True)[0])
        scores = ranking_of(self._model, normalised(self._model, observations))
        if scores is None:
            return actions, None
        return actions, orders_from_scores(scores, actions)
