"""Parking task with an additional cost for disagreement in a learned model."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.errors import ConfigError
from dynamics.learned.tasks.parking_state import SCALES
from mpc.tasks.costs import Disagreeing, DisagreementCost, Sum
from mpc.tasks.parking import ParkingTask

__all__ = ["CautiousTask"]


class CautiousTask:
    """`ParkingTask` with a `DisagreementCost`.

    Parameters
    ----------
    task : the parking task.
    ensemble : ensemble of models; it may differ from the planner's model.
    weight : weight of the members' standard deviations, summed over the observation's entries, at each evaluated state.

    Raises
    ------
    ConfigError
        If the weight is not a finite number of at least 0.
    """

    def __init__(self, task: ParkingTask, ensemble: Disagreeing, weight: float) -> None:
        if not (np.isfinite(weight) and weight >= 0):
            raise ConfigError(f"weight must be finite and at least 0, got {weight!r}")
        self.task, self.weight = task, float(weight)
        self._cost = DisagreementCost(ensemble, 1.0 / SCALES)

    @property
    def bases(self) -> list[Any]:
        """The environments of the task."""
        return self.task.bases

    def read(self, observation: Any) -> tuple[Any, Any, bool]:
        """See `ParkingTask.read`."""
        return self.task.read(observation)

    def cost(self, observation: Any, started: Any) -> Sum:
        """Cost of the task plus that of the disagreement; the success mask and the terminal weight apply to both."""
        total = self.task.cost(observation, started)
        return total + self.weight * Sum.of(self._cost) if self.weight else total
