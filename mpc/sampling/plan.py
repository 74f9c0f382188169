"""What a sampling planner is asked and what it answers, whatever the way it searches.

Notation
--------
E states that are planned for at once, S sampled plans for each, B blocks of inputs held for `hold` decisions, m inputs
and d state variables. A trajectory has T looked-at states: one every `look` decisions in the first `fine` blocks, then
one at the end of each block.
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

__all__ = ["Cost", "Fallback", "Grid", "Plan", "PlanMemory", "PlanStatus", "Trajectories", "evaluate", "read_states"]

Fallback = Callable[[Any], Any]
"""Actions (E, m) for states (E, d) where no plan is usable."""


class PlanStatus(StrEnum):
    """How a plan came about; the text says what to do."""

    PLANNED = "planned: use its action"
    TIME_LIMIT = "the time limit ended the search early: use its action, or raise time_limit or lower iterations"
    FALLBACK = "no sampled plan has a finite cost: the fallback action; repair the model or the cost"


@dataclass(frozen=True, slots=True, eq=False)
class Trajectories:
    """Sampled plans and where the model says they lead.

    Attributes
    ----------
    start : states now, (E, d).
    states : looked-at states, (E, S, T, d); the first is `spans[0]` decisions after `start`.
    actions : what leads to each of them, (E, S, T, m).
    spans : decisions since the looked-at state before, (T,), in the type of the states.
    memo : what several parts of a cost need and one of them has worked out; it lives as long as this object.
    """

    start: Any
    states: Any
    actions: Any
    spans: Any
    memo: dict[Any, Any] = field(default_factory=dict, init=False, repr=False)


@dataclass(frozen=True, slots=True)
class Grid:
    """Which states of a plan are looked at.

    Attributes
    ----------
    hold : decisions of a block. look : decisions between states in the first `fine` blocks; divides `hold`.
    fine : beyond these blocks only the last state of each is looked at.
    """

    hold: int
    look: int
    fine: int

    def rollout(self, model: StepModel, states: Any, samples: Any) -> tuple[Any, Any, Any]:
        """Looked-at states (n, T, d), their actions (n, T, m) and spans (T,), of states (n, d), blocks (n, B, m)."""
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
    """What is to be small."""

    def __call__(self, trajectories: Trajectories) -> Any:
        """Cost of each plan, (E, S). What is not finite is never chosen."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class PlanMemory:
    """What the next search starts from, one row for each state.

    Attributes
    ----------
    mean : the best plan, (E, B, m). elites : the best plans, (E, K, B, m).
    count : searches since the start of the episode, (E,); the random numbers of a search depend on it alone.
    warm : rows that hold a plan, (E,).
    """

    mean: Any
    elites: Any
    count: NDArray[np.int64]
    warm: NDArray[np.bool_]

    def forget(self, rows: Any) -> PlanMemory:
        """The same with these rows (mask or indices) as at the start of an episode."""
        count, warm = self.count.copy(), self.warm.copy()
        count[rows], warm[rows] = 0, False
        return PlanMemory(self.mean, self.elites, count, warm)


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """The answer of a planner. The arrays are the caller's own; without the axis E where one state was asked about.

    Attributes
    ----------
    action : what to do now, (E, m), inside the bounds, always finite; of a categorical planner (E,) integers.
    inputs : inputs of each block, (E, B, m). trajectory : looked-at states, (E, T, d), NaN in a fallback.
    cost : of the plan, (E,), inf in a fallback.
    elites, elite_costs : the best plans of the last iteration, (E, K, B, m), and their costs, (E, K).
    status : `PlanStatus` of each state, a tuple of E.
    iterations : iterations that were completed.
    time : spent on the search [s].
    memory : what the next search starts from (with the axis E).
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

    def single(self) -> Plan:
        """The plan of the first state, without the axis E."""
        names = ("action", "inputs", "trajectory", "cost", "elites", "elite_costs")
        return replace(self, **{name: getattr(self, name)[0] for name in names})


def read_states(model: StepModel, states: Any) -> tuple[Any, bool]:
    """States as (E, d), and whether there was one alone.

    Raises
    ------
    ModelError
        If they are no states of this model.
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
    states : (E, d). samples : inputs of each block, (E, S, B, m).
    grid : which states are looked at.

    Returns
    -------
    Costs (E, S), inf where a state or a cost is not finite, and states (E, S, T, d).

    Raises
    ------
    ModelError, ConfigError
        If the model or the cost answers with another shape.
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
