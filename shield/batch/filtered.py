"""Base class of batched highways with a filter: the traffic, the episodes, and the records."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from dynamics.highway_simulator.arrays import Worlds
from dynamics.highway_simulator.batch_arguments import checked_steps
from dynamics.highway_simulator.env import CompiledHighwayEnv
from dynamics.highway_simulator.simulator import Simulator
from dynamics.highway_simulator.step_kernels import write_rows
from dynamics.slices import Slices
from dynamics.state import BoolArray, FloatArray, IntArray
from shield.batch.arrays import empty_records
from shield.config import ShieldConfig
from shield.errors import ConfigError
from shield.supported_environments import check_frequency, check_perception, check_target_speeds

__all__ = ["FilteredHighways"]

_ROWS = 7
"""Number of columns of a vehicle row."""


class FilteredHighways(ABC):
    """Compiled highways with meta-actions, each with a filter.

    Parameters
    ----------
    env_id, num_envs, config, threads, replay_draws : as in `Simulator`.
    shield : settings, or the path of a TOML file with them.

    Raises
    ------
    ConfigError
        If the environment has no meta-actions, or as in `Simulator`.

    Attributes
    ----------
    simulator : the traffic.
    records : the last decisions, and their frames (`shield.batch.arrays.BatchRecords`).
    rows : vehicle rows after each frame of the last decision, (e, F, m, 7), see `CompiledHighwayEnv.frames`.
    off_road : whether the ego was off the road then, (e, F).
    """

    def __init__(
        self,
        env_id: str = "highway-fast-v0",
        num_envs: int = 1,
        config: Mapping[str, Any] | None = None,
        shield: ShieldConfig | str | Path | None = None,
        threads: int = 1,
        replay_draws: bool = False,
    ) -> None:
        self.config, self.num_envs = self._settings(shield), num_envs
        self.simulator: Any = self._traffic(env_id, num_envs, config, replay_draws)
        scenario = self.simulator.scenario
        if scenario.inputs is not None:
            raise ConfigError("many shields at once filter meta-actions; this environment has ContinuousAction")
        if self.config.mode != "none":
            check_target_speeds(self.simulator.rules.target_speeds)
            check_perception(self.simulator.rules.target_speeds, self.config)
            check_frequency(scenario.config["simulation_frequency"], self.config.simulates)
        frames = self.simulator.rules.numbers[0]
        self.records = empty_records(num_envs, frames)
        self.rows = np.zeros((num_envs, frames, scenario.bodies, _ROWS))
        self.off_road = np.zeros((num_envs, frames), np.bool_)
        self._no_orders = np.zeros((num_envs, 0), np.intp)
        self._slices = Slices(num_envs, threads)
        self._prepare(len(self._slices.bounds))

    def _traffic(self, env_id: str, num_envs: int, config: Mapping[str, Any] | None, replay_draws: bool) -> Any:
        """The simulator."""
        return Simulator(env_id, num_envs, config, replay_draws=replay_draws)

    @abstractmethod
    def _settings(self, shield: ShieldConfig | str | Path | None) -> ShieldConfig:
        """The settings; raises ConfigError if they need a feature that is not compiled."""

    @abstractmethod
    def _prepare(self, threads: int) -> None:
        """Allocate the memory of each environment and the workspace of each thread."""

    @abstractmethod
    def _forget(self, e: int) -> None:
        """Reset the memory of one environment for a new episode."""

    @abstractmethod
    def _decide(self, part: int, first: int, last: int, actions: IntArray, orders: IntArray, again: bool) -> None:
        """One decision in each of the environments from `first` to `last`, which belong to thread `part`."""

    @abstractmethod
    def _mask(self, part: int, first: int, last: int, masks: BoolArray) -> None:
        """Write the actions that verify in each of the environments from `first` to `last`, which belong to thread
        `part`, to `masks` (e, actions). The memory does not change."""

    def masks(self, fill: bool = True) -> BoolArray:
        """Mask of actions that verify now in each environment, (e, actions). With `fill`, all True where none does.
        Read-only: changes no memory, record or later decision."""
        masks = np.zeros((self.num_envs, self.actions), np.bool_)
        self._slices.run(lambda k, first, last: self._mask(k, first, last, masks))
        if fill:
            masks[~masks.any(axis=1)] = True
        return masks

    def reset(
        self, seeds: Sequence[int] | NDArray[Any] | None = None, which: Sequence[int] | None = None
    ) -> NDArray[np.float32]:
        """Start new episodes; see `Simulator.reset`."""
        observations = self.simulator.reset(seeds, which)
        for e in range(self.num_envs) if which is None else which:
            self._forget(e)
        found: NDArray[np.float32] = observations
        return found

    def reset_to(self, uniforms: FloatArray, which: Sequence[int]) -> NDArray[np.float32]:
        """Start episodes in given scenes; see `Simulator.reset_to`."""
        observations = self.simulator.reset_to(uniforms, which)
        for e in which:
            self._forget(e)
        found: NDArray[np.float32] = observations
        return found

    def write_rows(self, e: int, rows: FloatArray) -> bool:
        """Write the bodies of one environment to `rows`, (m, 7). Return whether the ego is on the road."""
        return bool(write_rows(self.simulator.worlds, self.simulator.scenario.rules, e, rows))

    @property
    def worlds(self) -> Worlds:
        """The state of the traffic (see `dynamics.highway_simulator.arrays.Worlds`)."""
        worlds: Worlds = self.simulator.worlds
        return worlds

    def one(self) -> gym.Env[Any, Any]:
        """One such environment without a filter."""
        scenario = self.simulator.scenario
        return CompiledHighwayEnv(scenario.env_id, scenario.config)

    @property
    def steps(self) -> int:
        """Number of decisions of an episode, plus one."""
        duration, decision = self.simulator.rules.times[2], self.simulator.rules.times[1]
        return int(np.ceil(duration / decision)) + 1

    @property
    def actions(self) -> int:
        """Number of meta-actions."""
        return len(self.simulator.rules.labels)

    def step_first(
        self, actions: Any, count: int
    ) -> tuple[NDArray[np.float32], FloatArray, NDArray[np.bool_], NDArray[np.bool_]]:
        """`step` in the first `count` environments only. The returned arrays keep their previous values for the
        others."""
        return self._step(actions, None, False, range(count))

    def step(
        self,
        actions: Any,
        orders: IntArray | None = None,
        again: bool = False,
        which: Sequence[int] | NDArray[Any] | None = None,
    ) -> tuple[NDArray[np.float32], FloatArray, NDArray[np.bool_], NDArray[np.bool_]]:
        """One shielded decision in each environment.

        Parameters
        ----------
        actions : meta-actions, (e,). An invalid one is replaced by the fallback, as for a policy that fails.
        orders : the policy's order of preference among the other actions in each environment, (e, k), up to the first
            negative entry. Where it is missing or empty, the documented order is used.
        again, which : as in `Simulator.step`.

        Returns
        -------
        As from `Simulator.step`; `records` holds the decisions.
        """
        return self._step(actions, orders, again, which)

    def _step(
        self, actions: Any, orders: IntArray | None, again: bool, which: Sequence[int] | NDArray[Any] | None
    ) -> tuple[NDArray[np.float32], FloatArray, NDArray[np.bool_], NDArray[np.bool_]]:
        """`step`, in the environments `which`."""
        proposed = np.asarray(actions)
        if proposed.shape != (self.num_envs,) or proposed.dtype.kind not in "iu":
            raise ConfigError(f"have a meta-action for each of {self.num_envs} environments, not {actions!r}")
        given = np.ascontiguousarray(proposed, np.intp)
        if self.config.mode == "none" and not ((given >= 0) & (given < self.actions)).all():
            raise ConfigError(f"have meta-actions from 0 to {self.actions - 1}, not {actions!r}")
        ranked = self._no_orders if orders is None else np.ascontiguousarray(orders, np.intp)
        if ranked.ndim != 2 or len(ranked) != self.num_envs or (ranked.size and ranked.max() >= self.actions):
            raise ConfigError(f"have orders of shape ({self.num_envs}, k) of the actions, not {ranked.shape}")

        def part(k: int, first: int, last: int) -> None:
            self._decide(k, first, last, given, ranked, again)

        self._slices.run(part, checked_steps(self.num_envs, which))
        shown = self.simulator.seen
        return shown.observations, shown.reward, shown.terminated, shown.truncated
