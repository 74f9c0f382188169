r"""The Cross-Entropy Method over meta-actions: a plan is a sequence of choices, with a table as distribution.

Notation
--------
A plan is B choices among A actions, each repeated for `hold` decisions. N plans are drawn from independent
probabilities p (B, A). The K cheapest give their frequencies f, and p becomes momentum p + (1 - momentum) f. In small
problems, A^B <= `samples`, all plans are evaluated instead, once.
Source: Rubinstein 1999, for a product of categorical distributions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from time import perf_counter
from typing import Any

import numpy as np

from dynamics.errors import ConfigError
from dynamics.learned.models.model import StepModel
from mpc.sampling.plan import Cost, Fallback, Grid, PlanMemory, PlanStatus, SampledPlan, evaluate, read_states

__all__ = ["CategoricalCEM", "CategoricalSettings"]

_TABLES = 61


@dataclass(frozen=True, slots=True)
class CategoricalSettings:
    """Settings of the search over choices.

    Attributes
    ----------
    blocks, hold, look : choices in a plan, decisions of each choice, and decisions between evaluated states.
    iterations, samples, elites : iterations of the search, plans and cheapest plans of each.
    momentum : share of the old probabilities in the new ones.
    floor : least probability of an action.
    time_limit : greatest time of a search [s], as in `PlannerSettings`.
    seed : seed of the planner's random numbers.
    """

    blocks: int = 4
    hold: int = 1
    look: int = 1
    iterations: int = 4
    samples: int = 128
    elites: int = 16
    momentum: float = 0.2
    floor: float = 0.02
    time_limit: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("blocks", "hold", "look", "iterations", "elites"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} must be at least 1, got {getattr(self, name)!r}")
        if self.samples < self.elites or self.hold % self.look:
            raise ConfigError("samples must be at least elites, and look must divide hold")
        if not (0 <= self.momentum < 1 and 0 <= self.floor < 1):
            raise ConfigError("momentum and floor must be in [0, 1)")
        if self.time_limit is not None and not self.time_limit > 0:
            raise ConfigError(f"time_limit must be positive [s] or None, got {self.time_limit!r}")

    def replace(self, **changes: Any) -> CategoricalSettings:
        """A copy with some values changed."""
        return replace(self, **changes)


class CategoricalCEM:
    """The Cross-Entropy Method over `actions` choices.

    The model receives a choice as one input, its index: `action_dim` is 1.

    Parameters
    ----------
    model : a model with `state_dim`, `action_dim` = 1 and `step(states, actions)`.
    actions : number of choices.
    settings : settings of the search.
    fallback : choices (E,) for states without a plan of finite cost; 0 by default.

    Examples
    --------
    >>> class Counter:
    ...     state_dim, action_dim = 1, 1
    ...     def step(self, states, actions):
    ...         return states + actions - 2
    >>> planner = CategoricalCEM(Counter(), actions=5)
    >>> plan = planner.plan(np.zeros(1), lambda t: np.abs(t.states[..., -1, 0] - 8))
    >>> int(plan.action), float(plan.cost)
    (4, 0.0)
    """

    def __init__(
        self,
        model: StepModel,
        actions: int,
        settings: CategoricalSettings | None = None,
        fallback: Fallback | None = None,
    ) -> None:
        self.settings = s = settings if settings is not None else CategoricalSettings()
        if model.action_dim != 1 or actions < 2:
            raise ConfigError(
                f"choices are one input and at least 2, got action_dim {model.action_dim} and {actions} actions"
            )
        self.model, self.actions, self.fallback = model, actions, fallback
        self._grid = Grid(s.hold, s.look, s.blocks)
        self._all: Any = None
        if actions**s.blocks <= s.samples:
            self._all = np.array(list(product(range(actions), repeat=s.blocks)), np.float32)
        else:
            generator = np.random.default_rng(s.seed)
            self._uniform = generator.random((_TABLES, s.samples, s.blocks), dtype=np.float32)

    def plan(self, state: Any, cost: Cost, memory: PlanMemory | None = None) -> SampledPlan:
        """The cheapest plan of the search; parameters and errors as in `mpc.sampling.cem.SamplingPlanner.plan`."""
        begin = perf_counter()
        states, single = read_states(self.model, state)
        s, e, rows = self.settings, len(states), np.arange(len(states))
        if memory is None:
            blank = np.zeros((e, s.blocks, 1), np.float32)
            memory = PlanMemory(blank, blank[:, None], np.zeros(e, np.int64), np.zeros(e, bool))
        if memory.mean.shape != (e, s.blocks, 1):
            raise ConfigError(f"memory is of other plans: {memory.mean.shape}, this planner has {(e, s.blocks, 1)}")
        p = np.full((e, s.blocks, self.actions), 1 / self.actions, np.float32)
        best, best_cost = np.zeros((e, s.blocks, 1), np.float32), np.full(e, np.inf)
        trajectory: Any = None
        slowest, limited, done = 0.0, False, 0
        for i in range(1 if self._all is not None else s.iterations):
            now = perf_counter()
            if i and s.time_limit is not None and now - begin + slowest > s.time_limit:
                limited = True
                break
            samples = self._draw(p, memory, i)
            if i == 0:
                # The present plan, one decision later, is also a candidate.
                samples = np.concatenate([samples, self._later(memory)], axis=1)
            costs, reached = evaluate(self.model, cost, states, samples[..., None], self._grid)
            order = np.argsort(costs, axis=1, kind="stable")[:, : s.elites]
            elites, elite_costs = np.take_along_axis(samples, order[..., None], 1), np.take_along_axis(costs, order, 1)
            better = elite_costs[:, 0] < best_cost
            best = np.where(better[:, None, None], elites[:, 0, :, None], best)
            best_cost = np.where(better, elite_costs[:, 0], best_cost)
            found = reached[rows, order[:, 0]]
            trajectory = found if trajectory is None else np.where(better[:, None, None], found, trajectory)
            p = self._move(p, elites, elite_costs)
            slowest, done = max(slowest, perf_counter() - now), done + 1
        bad = ~np.isfinite(best_cost)
        action = best[:, 0, 0].astype(np.int64)
        if bad.any():
            fallback_action = (
                np.zeros(e, np.int64) if self.fallback is None else np.asarray(self.fallback(states), np.int64)
            )
            action[bad] = np.clip(fallback_action, 0, self.actions - 1)[bad]
            best[bad] = action[bad, None, None]
        usual = PlanStatus.TIME_LIMIT if limited else PlanStatus.PLANNED
        plan = SampledPlan(
            action=action,
            inputs=best,
            trajectory=np.where(bad[:, None, None], np.nan, trajectory),
            cost=best_cost,
            elites=elites[..., None],
            elite_costs=elite_costs,
            status=tuple(PlanStatus.FALLBACK if b else usual for b in bad),
            iterations=done,
            time=perf_counter() - begin,
            memory=PlanMemory(best.copy(), best[:, None].copy(), memory.count + 1, ~bad),
        )
        return plan.single() if single else plan

    def _draw(self, p: Any, memory: PlanMemory, i: int) -> Any:
        """Samples (E, N, B) as indices of choices."""
        if self._all is not None:
            return np.broadcast_to(self._all, (len(p), *self._all.shape))
        u = self._uniform[(memory.count * self.settings.iterations + i) % _TABLES]
        edges = np.cumsum(p, axis=-1)[:, None, :, :-1]
        return (u[..., None] > edges).sum(axis=-1).astype(np.float32)

    def _later(self, memory: PlanMemory) -> Any:
        """The last plan one decision later, (E, 1, B); its last choice is repeated. All zeros without a plan."""
        s, plan = self.settings, memory.mean[..., 0]
        if s.hold == 1:
            plan = np.concatenate([plan[:, 1:], plan[:, -1:]], axis=1)
        return np.where(memory.warm[:, None], plan, 0.0).astype(np.float32)[:, None]

    def _move(self, p: Any, elites: Any, costs: Any) -> Any:
        s = self.settings
        weight = np.isfinite(costs).astype(np.float32)[..., None, None]
        hits = (elites[..., None] == np.arange(self.actions)) * weight
        share = hits.sum(axis=1) / np.maximum(weight.sum(axis=1), 1)
        usable = np.isfinite(costs).any(axis=1)[:, None, None]
        moved = np.maximum(s.momentum * p + (1 - s.momentum) * share, s.floor)
        return np.where(usable, moved / moved.sum(axis=-1, keepdims=True), p).astype(np.float32)
