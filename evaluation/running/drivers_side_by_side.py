"""Drivers of a batch of environments: actions fixed in advance, and those of a model."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dynamics.state import IntArray
from evaluation.running.named_policies import ConstantPolicy, RandomActions, WeavingPolicy
from shield.wrappers.ranking import normalised, orders_from_scores, ranking_of

__all__ = ["BatchDrivers", "GivenActions", "ModelBatchDrivers", "OpenLoopDrivers"]


class BatchDrivers(Protocol):
    """One policy that drives every environment of a batch."""

    def begin(self, e: int, seed: int) -> None:
        """Prepare for a new episode in environment `e`."""

    def act(self, observations: NDArray[np.float32], steps: IntArray) -> tuple[IntArray, IntArray | None]:
        """Actions of one step.

        Parameters
        ----------
        observations : observations of all environments.
        steps : number of past decisions of each episode, (e,).

        Returns
        -------
        The action of each environment (e,), and the order of preference over the others, or None.
        """


class OpenLoopDrivers:
    """Policies without observations: all actions of an episode are fixed at its start, (steps,)."""

    def __init__(self, policy: ConstantPolicy | RandomActions | WeavingPolicy, envs: int, steps: int) -> None:
        self._policy, self._actions = policy, np.zeros((envs, steps), np.intp)

    def begin(self, e: int, seed: int) -> None:
        """Draw the actions of the episode."""
        self._actions[e] = self._policy.plan(seed, self._actions.shape[1])

    def act(self, observations: NDArray[np.float32], steps: IntArray) -> tuple[IntArray, IntArray | None]:
        """The next action of each environment."""
        return self._actions[np.arange(len(steps)), steps], None


class GivenActions:
    """Given sequences of actions, (e, steps); the last one is repeated."""

    def __init__(self, actions: IntArray) -> None:
        self._actions = actions

    def begin(self, e: int, seed: int) -> None:
        """Nothing to prepare."""

    def act(self, observations: NDArray[np.float32], steps: IntArray) -> tuple[IntArray, IntArray | None]:
        """The next action of each environment."""
        return self._actions[np.arange(len(steps)), np.minimum(steps, self._actions.shape[1] - 1)], None


class ModelBatchDrivers:
    """An SB3 model with one prediction for the observations of all environments."""

    def __init__(self, model: Any) -> None:
        self._model = model

    def begin(self, e: int, seed: int) -> None:
        """Nothing to prepare."""

    def act(self, observations: NDArray[np.float32], steps: IntArray) -> tuple[IntArray, IntArray | None]:
        """The model's actions, and its order of preference by scores, if it has scores."""
        actions = np.asarray(self._model.predict(observations, deterministic=True)[0])
        scores = ranking_of(self._model, normalised(self._model, observations))
        if scores is None:
            return actions, None
        return actions, orders_from_scores(scores, actions)
