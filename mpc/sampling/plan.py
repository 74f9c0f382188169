"""Inputs and results of a sampling planner, independent of its search.

Notation
--------
E states in a batch, S sampled plans for each, B blocks of inputs repeated for `hold` decisions, m inputs and d state
variables. A trajectory has T evaluated states: one every `look` decisions in the first `fine` blocks, then one at the
end of each block.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dynamics.errors import ConfigError, ModelError
from dynamics.learned.models.model import StepModel, rollout_held

__all__ = [
    "Cost",
    "Fallback",
    "Grid",
    "PlanMemory",
    "PlanStatus",
    "SampledPlan",
    "Trajectories",
    "evaluate",
    "read_states",
]

Fallback = Callable[[Any], Any]
"""Actions (E, m) for states (E, d) without a usable plan."""


class PlanStatus(StrEnum):
    """Status of a plan; the text contains the advice."""

    PLANNED = "planned: use its action"
    TIME_LIMIT = "the time limit ended the search early: use its action, or raise time_limit or lower iterations"
    FALLBACK = "no sampled plan has a finite cost: the fallback action; repair the model or the cost"


@dataclass(frozen=True, slots=True, eq=False)
class Trajectories:
    """Sampled plans and the model's predictions for them.

    Attributes
    ----------
    start : present states, (E, d).
    states : evaluated states, (E, S, T, d); the first is `spans[0]` decisions after `start`.
    actions : inputs that lead to each of them, (E, S, T, m).
    spans : decisions since the previous evaluated state, (T,), in the type of the states.
    memo : cache of intermediate values that several parts of a cost share.
    """

    start: Any
    states: Any
    actions: Any
    spans: Any
    memo: dict[Any, Any] = field(default_factory=dict, init=False, repr=False)


@dataclass(frozen=True, slots=True)
class Grid:
    """Evaluated states of a plan.

    Attributes
    ----------
    hold : decisions of a block.
    look : decisions between states in the first `fine` blocks; divides `hold`.
    fine : number of blocks with this resolution; in later ones only the last state is evaluated.
    """

    hold: int
    look: int
    fine: int

    def rollout(self, model: StepModel, states: Any, samples: Any) -> tuple[Any, Any, Any]:
        """Evaluated states (n, T, d), actions (n, T, m) and spans (T,), from states (n, d) and blocks (n, B, m)."""
        parts = self.hold // self.look
        near = np.repeat(samples[:, : self.fine], parts, axis=1) if parts > 1 else samples[:, : self.fine]
        far = samples[:, self.fine :]
        reached = [states[:, None]]
        for actions, hold in ((near, self.look), (far, self.hold)):
            if actions.shape[1]:
                expected = (*actions.shape[:2], model.state_dim)
                reached.append(np.asarray(rollout_held(model, reached[-1][:, -1], actions, hold)))
                if reached[-1].shape != expected:
                    raise ModelError(f"the model's rollout must be {expected}, got {reached[-1].shape}")
        spans = np.repeat(np.array([self.look, self.hold], reached[-1].dtype), [near.shape[1], far.shape[1]])
        return np.concatenate(reached[1:], axis=1), np.concatenate([near, far], axis=1), spans


class Cost(Protocol):
    """Cost of trajectories, to be minimised."""

    def __call__(self, trajectories: Trajectories) -> Any:
        """Cost of each plan, (E, S). Plans with a cost that is not finite are never chosen."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class PlanMemory:
    """Start of the next search, one row for each state.

    Attributes
    ----------
    mean : the best plan, (E, B, m).
    elites : the best plans, (E, K, B, m).
    count : number of searches since the start of the episode, (E,); it alone determines the random numbers of a search.
    warm : rows with a plan, (E,).
    """

    mean: Any
    elites: Any
    count: NDArray[np.int64]
    warm: NDArray[np.bool_]

    def forget(self, rows: Any) -> PlanMemory:
        """A copy with these rows (mask or indices) as at the start of an episode."""
        count, warm = self.count.copy(), self.warm.copy()
        count[rows], warm[rows] = 0, False
        return PlanMemory(self.mean, self.elites, count, warm)


@dataclass(frozen=True, slots=True, eq=False)
class SampledPlan:
    """Result of a planner. The arrays belong to the caller; they have no axis E for a single state.

    Attributes
    ----------
    action : action of this decision, (E, m), inside the bounds, always finite; (E,) integers of a categorical planner.
    inputs : inputs of each block, (E, B, m).
    trajectory : evaluated states, (E, T, d), NaN in a fallback.
    cost : cost of the plan, (E,), inf in a fallback.
    elites, elite_costs : the best plans of the last iteration, (E, K, B, m), and their costs, (E, K).
    status : `PlanStatus` of each state, a tuple of E.
    iterations : number of completed iterations.
    time : time of the search [s].
    memory : start of the next search (with the axis E).
    """

    action: Any
    inputs: Any
    trajectory: Any
    cost: Any
    elites: Any
    elite_costs: Any
    status: tuple[PlanStatus, ...]
    iterations: int
    time: float
    memory: PlanMemory

    def single(self) -> SampledPlan:
        """The plan of the first state, without the axis E."""
        names = ("action", "inputs", "trajectory", "cost", "elites", "elite_costs")
        return replace(self, **{name: getattr(self, name)[0] for name in names})


def read_states(model: StepModel, states: Any) -> tuple[Any, bool]:
    """States as (E, d), and whether there was a single one.

    Raises
    ------
    ModelError
        If their shape does not fit the model.
    """
    array = np.asarray(states)
    single = array.ndim == 1
    array = array[None] if single else array
    if array.ndim != 2 or array.shape[1] != model.state_dim or not len(array):
        d = model.state_dim
        raise ModelError(f"states must have shape ({d},) or (E, {d}), got {np.shape(states)}")
    return array, single


def evaluate(model: StepModel, cost: Cost, states: Any, samples: Any, grid: Grid) -> tuple[Any, Any]:
    """Cost of sampled plans, and their trajectories.

    Parameters
    ----------
    model : the model.
    cost : the cost.
    states : present states, (E, d).
    samples : inputs of each block, (E, S, B, m).
    grid : selection of the evaluated states.

    Returns
    -------
    Costs (E, S), inf if a state or a cost is not finite, and states (E, S, T, d).

    Raises
    ------
    ModelError, ConfigError
        If the result of the model or the cost has another shape.
    """
    e, s = samples.shape[:2]
    with np.errstate(all="ignore"):
        flat, inputs, spans = grid.rollout(
            model, np.repeat(states, s, axis=0), samples.reshape(e * s, *samples.shape[2:])
        )
        reached, actions = (x.reshape(e, s, *x.shape[1:]) for x in (flat, inputs))
        costs = np.asarray(cost(Trajectories(states, reached, actions, spans)))
        if costs.shape != (e, s):
            raise ConfigError(f"the cost must have shape {(e, s)}, got {costs.shape}")
        good = np.isfinite(costs) & np.isfinite(reached.sum(axis=(2, 3)))
    return np.where(good, costs, np.inf), reached
