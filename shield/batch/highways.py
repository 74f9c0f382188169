"""`ShieldedHighways`: many compiled highways, each with a shield."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from highway_env.road.road import RoadNetwork

from dynamics.highway_simulator.arrays import Simulation, Worlds
from dynamics.highway_simulator.layout import LENGTH, WIDTH
from dynamics.roads.straight import StraightRoad
from dynamics.state import BoolArray, IntArray
from shield.batch.arrays import BatchMemory, empty_memory, new_batch_workspace
from shield.batch.filtered import FilteredHighways
from shield.batch.masking import mask_all
from shield.batch.observing import reset_memory
from shield.batch.parameters import BatchParameters, batch_parameters_of
from shield.batch.step_kernels import BatchPart, DecisionInputs, FrameRecords, ShieldArrays, step_all_shielded
from shield.config import ShieldConfig
from shield.pipelines.frames import ACCELERATIONS
from shield.supported_environments import refuse_simulated, require

__all__ = ["ShieldedHighways"]


class ShieldedHighways(FilteredHighways):
    """Copies of `highway-v0` or `highway-fast-v0` with meta-actions. Each has a shield with the same decisions as
    `ShieldedEnv` around one environment, bit for bit.

    Parameters
    ----------
    env_id, num_envs, config, threads, replay_draws : as in `Simulator`.
    shield : settings, or the path of a TOML file with them; of mode "full", with repair "hold" and without `record`, or
        of mode "none".

    Raises
    ------
    ConfigError
        If the environment or the settings need a feature that is not compiled; use `ShieldedEnv` then.

    Attributes
    ----------
    simulator, records, rows, off_road : as in `FilteredHighways`.
    shields : memory of the environments (`shield.batch.arrays.BatchMemory`).

    Examples
    --------
    >>> highways = ShieldedHighways("highway-fast-v0", 2)
    >>> observations = highways.reset([0, 1])
    >>> observations, reward, terminated, truncated = highways.step([3, 3])
    >>> highways.records.margin.shape, highways.records.margins.shape
    ((2,), (2, 5))
    """

    def _settings(self, shield: ShieldConfig | str | Path | None) -> ShieldConfig:
        config = ShieldConfig.of(shield)
        refuse_simulated(config)
        if config.mode != "none":
            require(config, "many shields at once have", "ShieldedEnv", mode="full", repair="hold", record=False)
        return config

    def _prepare(self, threads: int) -> None:
        scenario, worlds = self.simulator.scenario, self.simulator.worlds
        lanes = scenario.config["lanes_count"]
        road = StraightRoad.from_network(RoadNetwork.straight_road_network(lanes, speed_limit=30))
        length, width = float(worlds.p[0, LENGTH, 0]), float(worlds.p[0, WIDTH, 0])
        self.parameters: BatchParameters = batch_parameters_of(self.config, scenario, road, length, width)
        others = scenario.bodies - 1
        self.shields = empty_memory(self.num_envs, others, self.parameters)
        self._frequency = float(scenario.config["simulation_frequency"])
        self._workspaces = [
            (self.simulator.new_work(), new_batch_workspace(others, self.parameters, 9 * ACCELERATIONS), np.zeros(2))
            for _ in range(threads)
        ]

    def _forget(self, e: int) -> None:
        reset_memory(self.shields, e)

    def _decide(self, part: int, first: int, last: int, actions: IntArray, orders: IntArray, again: bool) -> None:
        simulator, (work, workspace, given) = self.simulator, self._workspaces[part]
        scenario = simulator.scenario
        simulation = Simulation(
            simulator.machine, simulator.worlds, scenario.rules, scenario.view, work, simulator.flat
        )
        shield, inputs = (
            ShieldArrays(self.shields, self.parameters, workspace, self.records),
            DecisionInputs(actions, orders, given),
        )
        frames, which = FrameRecords(self.rows, self.off_road), BatchPart(first, last, again)
        step_all_shielded(simulation, shield, inputs, frames, which, self._frequency)

    def _mask(self, part: int, first: int, last: int, masks: BoolArray) -> None:
        # An observation changes the memory, for example the count of violations. So the mask works on a copy.
        shields = BatchMemory._make(array[first:last].copy() for array in self.shields)
        worlds = Worlds._make(array[first:last] for array in self.worlds)
        mask_all(worlds, shields, self.parameters, self._workspaces[part][1], self.records, masks[first:last])
