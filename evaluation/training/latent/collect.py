"""Driving that fills the episode queue of a world model."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics.world_model.config import WorldModelConfig
from dynamics.world_model.episode_queue import Column
from evaluation.learning.fast_vec_env import FastHighwayVecEnv
from evaluation.running.named_policies import Policy

__all__ = ["Collector", "queue_columns"]


def queue_columns(config: WorldModelConfig) -> dict[str, Column]:
    """Columns of the episodes of a world model; see `dynamics.world_model.losses.COLUMNS`."""
    return {
        "frame": (config.shape, "uint8"),
        "action": ((), "int8"),
        "reward": ((), "float32"),
        "terminated": ((), "bool"),
        "crashed": ((), "bool"),
    }


class Collector:
    """Drives a batch of environments, and gives out the episodes that end.

    Parameters
    ----------
    world : environments that observe frames; it is seeded and reset here.
    seed : of the first environment, and of the exploration.
    exploration : share of the actions that are drawn uniformly.
    override_penalty : deduction from the reward of each decision that a shield overrides.

    Attributes
    ----------
    steps : number of decisions so far.
    """

    def __init__(self, world: FastHighwayVecEnv, seed: int, exploration: float, override_penalty: float = 0.0) -> None:
        self.world, self.exploration, self._penalty = world, exploration, override_penalty
        self._rng = np.random.default_rng(seed)
        world.seed(seed)
        self._observations = world.reset()
        self._start, self._state = np.ones(world.num_envs, bool), None
        self._open: list[list[tuple[Any, ...]]] = [[] for _ in range(world.num_envs)]
        self.steps = 0

    def step(self, policy: Policy | None) -> list[dict[str, NDArray[Any]]]:
        """Drive one decision in each environment, with uniform actions without a policy. Returns ended episodes."""
        count, actions = self.world.num_envs, self._uniform()
        if policy is not None:
            chosen, self._state = policy.predict(self._observations, self._state, self._start)
            actions = np.where(self._rng.random(count) < self.exploration, actions, chosen)
        frames = self._observations
        self._observations, rewards, done, infos = self.world.step(actions)
        ended = []
        for i, info in enumerate(infos):
            over = bool(done[i]) and not info["TimeLimit.truncated"]
            reward = rewards[i] - self._penalty * bool(info.get("shield", {}).get("overridden", False))
            self._open[i].append((frames[i], actions[i], reward, over, bool(info["crashed"])))
            if done[i]:
                columns = zip(*self._open[i], strict=True)
                names = ("frame", "action", "reward", "terminated", "crashed")
                ended.append({name: np.stack(column) for name, column in zip(names, columns, strict=True)})
                self._open[i] = []
        self._start = done
        self.steps += count
        return ended

    def _uniform(self) -> NDArray[np.int64]:
        found: NDArray[np.int64] = self._rng.integers(self.world.action_space.n, size=self.world.num_envs)  # type: ignore[attr-defined]
        return found
