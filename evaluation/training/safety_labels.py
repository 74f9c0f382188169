"""Labelled frames for a safety monitor: compiled highways that a driver drives without a shield, and for each action
whether simulated traffic has a verified continuation after it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.world_model import FrameView
from evaluation.learning.fast_vec_env import FastHighwayVecEnv
from shield.certificate.simulated.highways import SimulatedHighways
from shield.config import ShieldConfig

__all__ = ["EpisodeOutcomes", "LabelledHighways", "LabelledStates", "gather", "gather_episodes"]

Driver = Callable[[NDArray[Any], np.random.Generator], IntArray]
"""Actions (e,) from frames (e, 5, size, size)."""


class LabelledHighways(FastHighwayVecEnv):
    """Unshielded compiled highways with bird's-eye frames whose actions can be labelled.

    Parameters
    ----------
    num_envs, env_id, config, frames : as in `FastHighwayVecEnv`.
    """

    def __init__(
        self,
        num_envs: int = 64,
        env_id: str = "highway-fast-v0",
        config: Mapping[str, Any] | None = None,
        frames: FrameView | None = None,
    ) -> None:
        super().__init__(num_envs, env_id, config, 1, frames or FrameView())

    def _made(self, num_envs: int, env_id: str, config: Mapping[str, Any] | None, threads: int) -> Any:
        self._labelled = SimulatedHighways(env_id, num_envs, config, ShieldConfig.simulated_traffic(), threads)
        return self._labelled.simulator

    def labels(self) -> BoolArray:
        """Whether no verified continuation exists after each action in the present scenes, (e, actions)."""
        return ~self._labelled.masks(fill=False)


class LabelledStates(NamedTuple):
    """States of n decisions.

    Attributes
    ----------
    frames : (n, 5, size, size) uint8.
    unsafe : whether no verified continuation exists after each action, (n, actions).
    executed : actions, (n,).
    episodes, steps : number of the episode, and of the decision in it, (n,).
    """

    frames: NDArray[np.uint8]
    unsafe: BoolArray
    executed: IntArray
    episodes: IntArray
    steps: IntArray

    def take(self, rows: Any) -> LabelledStates:
        """Some of the states."""
        return LabelledStates(*(column[rows] for column in self))

    @classmethod
    def join(cls, parts: list[LabelledStates]) -> LabelledStates:
        """Several sets of states as one; episodes are renumbered."""
        first, numbered = 0, []
        for part in parts:
            numbered.append(part._replace(episodes=part.episodes + first))
            first += int(part.episodes.max(initial=-1)) + 1
        return cls(*(np.concatenate(columns) for columns in zip(*numbered, strict=True)))


def gather(world: LabelledHighways, drive: Driver, steps: int, seed: int, keep_safe: float = 1.0) -> LabelledStates:
    """Drive `steps` decisions in each environment, and keep labelled states.

    Parameters
    ----------
    world : the highways. drive : the driver. seed : of the first environment's episode, and of the driver.
    keep_safe : share of the states that are kept where every action has a verified continuation.
    """
    rng, e = np.random.default_rng(seed), world.num_envs
    world.seed(seed)
    frames = world.reset()
    numbers, lengths, following = np.arange(e), np.zeros(e, np.intp), e
    kept: list[LabelledStates] = []
    for _ in range(steps):
        actions, unsafe = drive(frames, rng), world.labels()
        keep = unsafe.any(axis=1) | (rng.random(e) < keep_safe)
        kept.append(LabelledStates(frames[keep], unsafe[keep], actions[keep], numbers[keep], lengths[keep]))
        frames, _, done, _ = world.step(actions)
        lengths += 1
        lengths[done] = 0
        numbers[done] = np.arange(following, following + int(done.sum()))
        following += int(done.sum())
    return LabelledStates(*(np.concatenate(columns) for columns in zip(*kept, strict=True)))


class EpisodeOutcomes(NamedTuple):
    """Outcomes of n episodes.

    Attributes
    ----------
    crashed : (n,) bool. returns : undiscounted, (n,). speeds : mean speed of the ego, (n,) [m/s].
    lengths : number of decisions, (n,).
    """

    crashed: BoolArray
    returns: FloatArray
    speeds: FloatArray
    lengths: IntArray


def gather_episodes(world: LabelledHighways, drive: Driver, seed: int) -> tuple[LabelledStates, EpisodeOutcomes]:
    """Drive one whole episode in each environment: all its labelled states, and the outcomes. Seeds are consecutive."""
    rng, e = np.random.default_rng(seed), world.num_envs
    world.seed(seed)
    frames = world.reset()
    open_, crashed = np.ones(e, np.bool_), np.zeros(e, np.bool_)
    returns, speeds, lengths = np.zeros(e), np.zeros(e), np.zeros(e, np.intp)
    kept: list[LabelledStates] = []
    while open_.any():
        rows, actions, unsafe = np.flatnonzero(open_), drive(frames, rng), world.labels()
        kept.append(LabelledStates(frames[rows], unsafe[rows], actions[rows], rows, lengths[rows].copy()))
        frames, reward, done, infos = world.step(actions)
        returns[rows] += reward[rows]
        speeds[rows] += [infos[i]["speed"] for i in rows]
        lengths[rows] += 1
        over = done & open_
        crashed[over] = [bool(infos[i]["crashed"]) for i in np.flatnonzero(over)]
        open_ &= ~done
    states = LabelledStates(*(np.concatenate(columns) for columns in zip(*kept, strict=True)))
    return states, EpisodeOutcomes(crashed, returns, speeds / lengths, lengths)
