"""One environment of highway-env itself, with what `ReportBatch` asks of compiled ones."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from dynamics.state import BoolArray, IntArray
from evaluation.learning.observations import FastObservations
from evaluation.measuring.recorder import History, Recorder
from evaluation.reproduction.variants import Variant
from evaluation.settings import Setting
from shield import ShieldedEnv
from shield.errors import ConfigError

__all__ = ["LiveRoad"]


class LiveRoad:
    """One live environment, behind `ShieldedEnv` with the settings that it chooses there if the variant has a shield.

    Parameters
    ----------
    setting, variant : what is driven.

    Raises
    ------
    ConfigError
        If the variant has `Shield` with actions alone.

    Attributes
    ----------
    actions, steps : how many meta-actions there are, and decisions of an episode at most.
    simulator : `seen` has the last observation (1, n, 5), reward, terminated and truncated, (1,) each.
    overridden : whether the shield did something else than it was asked for, (1,).
    report : what the shield says of the last decision; empty without one.
    """

    num_envs = 1

    def __init__(self, setting: Setting, variant: Variant) -> None:
        if variant.shield == "actions":
            raise ConfigError("Shield with actions alone is compiled on the highway only; here have ShieldedEnv")
        env: Any = FastObservations(setting.make())
        self._env: Any = ShieldedEnv(env) if variant.shield else env
        observation, _ = self._env.reset(seed=0)
        base: Any = self._env.unwrapped
        self.actions = int(cast(gym.spaces.Discrete, self._env.action_space).n)
        self.steps = int(np.ceil(base.config["duration"] * base.config["policy_frequency"])) + 1
        nothing = np.zeros(1, np.bool_)
        self.seen = SimpleNamespace(
            observations=np.asarray(observation, np.float32)[None],
            reward=np.zeros(1),
            terminated=nothing,
            truncated=nothing,
        )
        scenario = SimpleNamespace(observation_space=self._env.observation_space)
        self.simulator = SimpleNamespace(seen=self.seen, scenario=scenario)
        self.overridden: BoolArray = nothing
        self.report: dict[str, Any] = {}
        self._recorder: Recorder | None = None

    def reset(self, seeds: Sequence[int], which: Sequence[int]) -> NDArray[np.float32]:
        """Start an episode, see `FilteredHighways.reset`."""
        observation, _ = self._env.reset(seed=int(seeds[0]))
        self.seen.observations = np.asarray(observation, np.float32)[None]
        self.seen.terminated = self.seen.truncated = self.overridden = np.zeros(1, np.bool_)
        observations: NDArray[np.float32] = self.seen.observations
        return observations

    def record(self) -> None:
        """Keep the history of the episode that has just begun."""
        self._recorder = Recorder(self._env)

    def history(self) -> History:
        """What has been recorded."""
        assert self._recorder is not None
        return self._recorder.history()

    def step(self, actions: IntArray) -> None:
        """One decision."""
        observation, reward, terminated, truncated, info = self._env.step(int(actions[0]))
        self.seen.observations = np.asarray(observation, np.float32)[None]
        self.seen.reward = np.array([float(reward)])
        self.seen.terminated, self.seen.truncated = np.array([bool(terminated)]), np.array([bool(truncated)])
        self.report = info.get("shield", {})
        self.overridden = np.array([bool(self.report.get("overridden", False))])

    def masks(self) -> BoolArray:
        """Which meta-actions verify now, (1, actions)."""
        masks: BoolArray = np.asarray(self._env.get_wrapper_attr("action_masks")(), np.bool_)[None]
        return masks
