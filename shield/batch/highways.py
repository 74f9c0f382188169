"""`ShieldedHighways`: many compiled highways, each behind its shield."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

from dynamics.roads.straight import StraightRoad
from dynamics.simulator.engine import Worlds, look
from dynamics.simulator.layout import LENGTH, WIDTH
from dynamics.simulator.simulator import Simulator
from dynamics.state import FloatArray, IntArray
from shield.batch.arrays import Room, empty_records, empty_shields, new_room
from shield.batch.engine import step_all_shielded
from shield.batch.law import Law, law_of
from shield.batch.observing import forget
from shield.config import ShieldConfig
from shield.errors import ConfigError
from shield.procedures.frames import ACCELERATIONS

__all__ = ["ShieldedHighways"]

_ROWS = 7


class ShieldedHighways:
    """So many copies of `highway-v0` or `highway-fast-v0` with meta-actions, each behind the shield that `ShieldedEnv`
    is around one of them: the same decisions, bit for bit.

    Parameters
    ----------
    env_id, num_envs, config, threads, tape : as of `Simulator`.
    shield : settings, or the path of a TOML file with them; of mode "full", with repair "hold" and without `record`, or
        of mode "none".

    Raises
    ------
    ConfigError
        If the environment or the settings need what is not compiled; take `ShieldedEnv` then.

    Attributes
    ----------
    simulator : the traffic. shields : what is remembered (`shield.batch.arrays.Shields`).
    records : the last decisions, and their frames (`shield.batch.arrays.Records`).
    rows, off_road : the bodies after each frame of the last decision, (e, F, m, 7), see `CompiledHighwayEnv.frames`;
        and whether the ego was off the road then, (e, F).

    Examples
    --------
    >>> highways = ShieldedHighways("highway-fast-v0", 2)
    >>> observations = highways.reset([0, 1])
    >>> observations, reward, terminated, truncated = highways.step([3, 3])
    >>> highways.records.margin.shape, highways.records.margins.shape
    ((2,), (2, 5))
    """

    def __init__(
        self,
        env_id: str = "highway-fast-v0",
        num_envs: int = 1,
        config: Mapping[str, Any] | None = None,
        shield: ShieldConfig | str | Path | None = None,
        threads: int = 1,
        tape: bool = False,
    ) -> None:
        self.config = ShieldConfig.of(shield)
        _check(self.config)
        self.simulator = Simulator(env_id, num_envs, config, tape=tape)
        scenario, worlds = self.simulator.scenario, self.simulator.worlds
        if scenario.inputs is not None:
            raise ConfigError("many shields at once filter meta-actions; this environment has ContinuousAction")
        lanes = scenario.config["lanes_count"]
        road = StraightRoad.from_network(RoadNetwork.straight_road_network(lanes, speed_limit=30))
        length, width = float(worlds.p[0, LENGTH, 0]), float(worlds.p[0, WIDTH, 0])
        self.law: Law = law_of(self.config, scenario, road, length, width)
        e, m, frames = num_envs, scenario.bodies - 1, scenario.rules.numbers[0]
        self.num_envs, self.shields, self.records = e, empty_shields(e, m, self.law), empty_records(e, frames)
        self.rows = np.zeros((e, frames, m + 1, _ROWS))
        self.off_road = np.zeros((e, frames), np.bool_)
        self._no_orders = np.zeros((e, 0), np.intp)
        self._frequency = float(scenario.config["simulation_frequency"])
        bounds = np.linspace(0, e, min(threads, e) + 1).round().astype(int).tolist()
        self._parts: list[tuple[int, int, Any, Room, FloatArray]] = [
            (first, last, self.simulator.new_work(), new_room(m, self.law, 9 * ACCELERATIONS), np.zeros(2))
            for first, last in pairwise(bounds)
        ]
        self._pool = ThreadPoolExecutor(len(self._parts)) if len(self._parts) > 1 else None

    def reset(
        self, seeds: Sequence[int] | NDArray[Any] | None = None, which: Sequence[int] | None = None
    ) -> NDArray[np.float32]:
        """Start new episodes; see `Simulator.reset`."""
        observations = self.simulator.reset(seeds, which)
        for e in range(self.num_envs) if which is None else which:
            forget(self.shields, e)
        return observations

    def reset_to(self, shares: FloatArray, which: Sequence[int]) -> NDArray[np.float32]:
        """Start episodes in scenes of one's own choice; see `Simulator.reset_to`."""
        observations = self.simulator.reset_to(shares, which)
        for e in which:
            forget(self.shields, e)
        return observations

    def look(self, e: int, rows: FloatArray) -> bool:
        """The bodies of one environment as rows (m, 7); whether the ego is on the road."""
        return bool(look(self.simulator.worlds, self.simulator.scenario.rules, e, rows))

    @property
    def worlds(self) -> Worlds:
        """The state of the traffic (see `dynamics.simulator.engine.Worlds`)."""
        return self.simulator.worlds

    def step_first(
        self, actions: Any, count: int
    ) -> tuple[NDArray[np.float32], FloatArray, NDArray[np.bool_], NDArray[np.bool_]]:
        """`step` of the first `count` environments only; what it returns of the others is what was there before."""
        return self._step(actions, None, False, count)

    def step(
        self, actions: Any, orders: IntArray | None = None, again: bool = False
    ) -> tuple[NDArray[np.float32], FloatArray, NDArray[np.bool_], NDArray[np.bool_]]:
        """One shielded decision in each environment.

        Parameters
        ----------
        actions : meta-actions, (e,). What is none of them is replaced by the fallback, as of a policy that fails.
        orders : the policy's order of preference over the others in each, (e, k), which ends with the first negative
            one; where there is none, or the first is negative, the documented order.
        again : as of `Simulator.step`.

        Returns
        -------
        As of `Simulator.step`; `records` have what was decided.
        """
        return self._step(actions, orders, again, self.num_envs)

    def _step(
        self, actions: Any, orders: IntArray | None, again: bool, count: int
    ) -> tuple[NDArray[np.float32], FloatArray, NDArray[np.bool_], NDArray[np.bool_]]:
        proposed = np.asarray(actions)
        if proposed.shape != (self.num_envs,) or proposed.dtype.kind not in "iu":
            raise ConfigError(f"have a meta-action for each of {self.num_envs} environments, not {actions!r}")
        given = np.ascontiguousarray(proposed, np.intp)
        if self.config.mode == "none" and not ((given >= 0) & (given < len(self.law.labels))).all():
            raise ConfigError(f"have meta-actions from 0 to {len(self.law.labels) - 1}, not {actions!r}")
        ranked = self._no_orders if orders is None else np.ascontiguousarray(orders, np.intp)
        if ranked.ndim != 2 or len(ranked) != self.num_envs or (ranked.size and ranked.max() >= len(self.law.labels)):
            raise ConfigError(f"have orders of shape ({self.num_envs}, k) of the actions, not {ranked.shape}")
        simulator, seen = self.simulator, self.simulator.flat
        scenario = simulator.scenario

        def part(bounds: tuple[int, int, Any, Room, FloatArray]) -> None:
            first, last, work, room, action = bounds
            step_all_shielded(
                simulator.machine,
                simulator.worlds,
                scenario.rules,
                scenario.view,
                work,
                seen,
                self.shields,
                self.law,
                room,
                self.records,
                given,
                ranked,
                action,
                self.rows,
                self.off_road,
                min(first, count),
                min(last, count),
                again,
                self._frequency,
            )

        if self._pool is None:
            part(self._parts[0])
        else:
            list(self._pool.map(part, self._parts))
        shown = simulator.seen
        return shown.observations, shown.reward, shown.terminated, shown.truncated


def _check(config: ShieldConfig) -> None:
    """Raise where a setting is not compiled."""
    if config.mode == "none":
        return
    wanted = {"mode": "full", "repair": "hold", "record": False}
    other = [name for name, value in wanted.items() if getattr(config, name) != value]
    if other:
        have = ", ".join(f"{name} = {wanted[name]!r}" for name in other)
        raise ConfigError(f"many shields at once have {have} only; take ShieldedEnv for another {', '.join(other)}")
