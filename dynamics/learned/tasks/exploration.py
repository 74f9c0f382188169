"""Driving to collect data, episode after episode: a policy, with random meta-actions in a share of its decisions."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["Exploration"]


class Exploration:
    """An environment that is driven episode after episode.

    Parameters
    ----------
    env : a highway-env environment with meta-actions, or a wrapper of one.
    seed : of the random actions. policy : the driving policy (SB3's `predict`); None for random meta-actions.
    explore : share of the decisions in which a random action replaces the policy's.
    first_reset : seed of the first reset; each further episode adds 1.

    Attributes
    ----------
    episode : number of finished episodes.
    """

    def __init__(self, env: Any, seed: int, policy: Any, explore: float, first_reset: int) -> None:
        self._env, self._generator, self._policy, self._explore = env, np.random.default_rng(seed), policy, explore
        self._first_reset, self.episode = first_reset, 0
        self._state: Any = None
        self._begin()

    def choose(self) -> int:
        """The next action."""
        action = int(self._generator.integers(self._env.action_space.n))
        if self._policy is None:
            return action
        chosen, self._state = self._policy.predict(self._observation, self._state, np.array([self._fresh]))
        return action if self._generator.random() < self._explore else int(chosen)

    def carry_out(self, action: int) -> bool:
        """Execute an action. True if the episode has ended; then call `begin_anew`."""
        self._observation, _, terminated, truncated, _ = self._env.step(action)
        self._fresh = False
        return bool(terminated or truncated)

    def begin_anew(self) -> None:
        """Begin the next episode."""
        self.episode += 1
        self._begin()

    def _begin(self) -> None:
        self._observation, _ = self._env.reset(seed=self._first_reset + self.episode)
        self._state, self._fresh = None, True
