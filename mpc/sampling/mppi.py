r"""Model predictive path integral control: all samples count, weighted by the exponential of their cost.

Notation
--------
With costs c_i of N samples and the temperature T, the mean moves to sum w_i u_i / sum w_i with the weights
w_i = exp(-(c_i - min c) / T); the deviation stays the same. The result is the mean.
Source: Williams et al. 2017 (information-theoretic MPC).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.errors import ConfigError
from dynamics.learned.models.model import StepModel
from mpc.sampling.cem import PlannerSettings, SamplingPlanner
from mpc.sampling.plan import Fallback

__all__ = ["MPPI", "Softmax"]


@dataclass(frozen=True, slots=True)
class Softmax:
    """Mean of the samples, weighted by the exponential of the costs."""

    temperature: float

    def __call__(self, samples: Any, costs: Any, std: Any) -> tuple[Any, Any]:
        """See `mpc.sampling.cem.Update`."""
        finite = np.isfinite(costs)
        least = np.min(np.where(finite, costs, np.inf), axis=-1, keepdims=True)
        above = np.where(finite, costs - np.where(np.isfinite(least), least, 0), np.inf)
        weight = np.exp(-above / self.temperature)
        weight = weight / np.maximum(weight.sum(axis=-1, keepdims=True), 1e-30)
        mean = (weight[..., None, None] * samples).sum(axis=-3)
        return mean.astype(samples.dtype), std


class MPPI(SamplingPlanner):
    """Model predictive path integral control.

    Parameters
    ----------
    model, fallback, low, high : as in `mpc.sampling.cem.SamplingPlanner`.
    settings : `elites`, `keep`, `momentum` and `answer` are ignored; by default 3 iterations of 128 samples.
    temperature : T, in the unit of the cost.

    Examples
    --------
    >>> from dynamics.learned.models.bicycle import BicycleModel
    >>> planner = MPPI(BicycleModel(), temperature=0.1)
    >>> start = np.array([0.0, 0, 0, 0, 1, 0])
    >>> plan = planner.plan(start, lambda t: np.abs(t.states[..., -1, 0] - 20))
    >>> plan.status[0].name, bool(plan.cost < 1)
    ('PLANNED', True)
    """

    def __init__(
        self,
        model: StepModel,
        settings: PlannerSettings | None = None,
        fallback: Fallback | None = None,
        temperature: float = 0.1,
        low: Any = -1.0,
        high: Any = 1.0,
    ) -> None:
        if not (np.isfinite(temperature) and temperature > 0):
            raise ConfigError(f"temperature must be positive, got {temperature!r}")
        s = settings if settings is not None else PlannerSettings(iterations=3, samples=128, std=0.6, warm=True)
        s = s.replace(elites=s.samples, decay=1.0, keep=0.0, momentum=0.0, answer="mean")
        super().__init__(model, s, Softmax(temperature), fallback, low, high)
