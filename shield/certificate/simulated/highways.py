"""`SimulatedHighways`: many compiled highways, each with its meta-actions verified by simulation."""

from __future__ import annotations

from pathlib import Path

from dynamics.state import BoolArray, IntArray
from shield.batch.filtered import FilteredHighways
from shield.batch.step_kernels import BatchPart, DecisionInputs, FrameRecords
from shield.certificate.simulated.decision_kernels import empty_plans
from shield.certificate.simulated.masking import mask_all
from shield.certificate.simulated.step_kernels import SimulatedShields, step_all_simulated
from shield.certificate.simulated.workspace import new_search
from shield.config import ShieldConfig
from shield.supported_environments import check, require

__all__ = ["SimulatedHighways"]


class SimulatedHighways(FilteredHighways):
    """Copies of `highway-v0` or `highway-fast-v0` with meta-actions. Each has a filter with the same decisions as
    `Shield` with `ShieldConfig.simulated_traffic()` and `frames=False` around one environment.

    Parameters
    ----------
    env_id, num_envs, config, threads, replay_draws : as in `Simulator`.
    shield : settings with `Assumptions.simulated_traffic()`, or the path of a TOML file with them; by default
        `ShieldConfig.simulated_traffic()`.

    Raises
    ------
    ConfigError
        If the simulator cannot run the environment, its actions are not meta-actions, or the settings are others.

    Attributes
    ----------
    simulator, records, rows, off_road : as in `FilteredHighways`.
    plans : the stored sequences (`shield.certificate.simulated.decision_kernels.StoredSequences`).

    Examples
    --------
    >>> highways = SimulatedHighways("highway-fast-v0", 2)
    >>> observations = highways.reset([0, 1])
    >>> observations, reward, terminated, truncated = highways.step([3, 3])
    >>> highways.records.executed
    array([3, 3])
    """

    def _settings(self, shield: ShieldConfig | str | Path | None) -> ShieldConfig:
        config = ShieldConfig.of(shield, ShieldConfig.simulated_traffic())
        check(config)
        require(config, "many shields at once have", "Shield", record=False)
        return config

    def _prepare(self, threads: int) -> None:
        self._searches = [new_search(self.simulator, self.config) for _ in range(threads)]
        self.plans = empty_plans(self.num_envs, self._searches[0].bounds.depth)

    def _forget(self, e: int) -> None:
        self.plans.length[e] = 0

    def _decide(self, part: int, first: int, last: int, actions: IntArray, orders: IntArray, again: bool) -> None:
        simulator, search = self.simulator, self._searches[part]
        step_all_simulated(
            SimulatedShields(search, self.plans, self.records),
            simulator.worlds,
            simulator.scenario.view,
            simulator.flat,
            DecisionInputs(actions, orders, search.given),
            FrameRecords(self.rows, self.off_road),
            BatchPart(first, last, again),
        )

    def _mask(self, part: int, first: int, last: int, masks: BoolArray) -> None:
        mask_all(self._searches[part], self.worlds, self.plans, masks, first, last)
