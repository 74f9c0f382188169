r"""Sampling planners: the Cross-Entropy Method, iCEM and several restarts of it.

Notation
--------
A plan is B blocks of m inputs in [-1, 1], each repeated for `hold` decisions. In every iteration each of R restarts
draws N plans from its own normal distribution, clips them to the bounds, and moves the distribution to its K cheapest
(the *elites*). All restarts, of all states, go through the model in one call. The result is the plan with the least
cost of all iterations and restarts.

- Plain CEM: white noise, no memory. Source: Rubinstein 1999; the planner of highway-env's parking notebook.
- iCEM: coloured noise, elites kept between iterations and decisions, the last plan as the next mean, and decreasing
  numbers of samples. Source: Pinneri et al. 2020.
- Multi-start: R > 1. Only the first restart starts from the last plan, so the search is not limited to a local minimum.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from dynamics.errors import ConfigError
from dynamics.learned.models.model import StepModel
from mpc.sampling.noise import NoiseBank
from mpc.sampling.plan import Cost, Fallback, PlanMemory, PlanStatus, SampledPlan, evaluate, read_states
from mpc.sampling.sampler_settings import PlannerSettings

__all__ = ["CEM", "Eliting", "PlannerSettings", "SamplingPlanner", "Update"]

_TABLES = 61
"""Number of noise tables; prime, so that searches with any number of iterations use all of them."""


class Update(Protocol):
    """Function that moves a distribution to its samples."""

    def __call__(self, samples: Any, costs: Any, std: Any) -> tuple[Any, Any]:
        """Mean and standard deviation, (..., B, m) each.

        Parameters
        ----------
        samples : (..., K, B, m), the cheapest first.
        costs : (..., K); samples of infinite cost have no weight. If all costs are infinite, the result is not used.
        std : deviation of the sampled distribution, (..., B, m).
        """
        ...


@dataclass(frozen=True, slots=True)
class Eliting:
    """Mean and deviation of the samples, which are the elites."""

    def __call__(self, samples: Any, costs: Any, std: Any) -> tuple[Any, Any]:
        """See `Update`."""
        weight = np.isfinite(costs)[..., None, None].astype(samples.dtype)
        total = np.maximum(weight.sum(axis=-3), 1)
        mean = (weight * samples).sum(axis=-3) / total
        spread = (weight * (samples - mean[..., None, :, :]) ** 2).sum(axis=-3) / total
        return mean, np.sqrt(spread)


class SamplingPlanner:
    """Search that all planners of continuous inputs share.

    Parameters
    ----------
    model : a model with `state_dim`, `action_dim` and `step(states, actions)` (see `dynamics.learned.models.model`).
    settings : settings of the search.
    update : function that moves the distribution to the elites.
    fallback : actions for states without a plan of finite cost; zeros by default.
    low, high : bounds of the inputs, each broadcastable to (m,); by default [-1, 1], and never wider.

    Raises
    ------
    ConfigError
        If a bound has the wrong shape or value.
    """

    def __init__(
        self,
        model: StepModel,
        settings: PlannerSettings,
        update: Update,
        fallback: Fallback | None = None,
        low: Any = -1.0,
        high: Any = 1.0,
    ) -> None:
        self.model, self.settings, self.update, self.fallback = model, settings, update, fallback
        m = model.action_dim
        try:
            self.low, self.high = (np.broadcast_to(np.asarray(x, np.float32), (m,)) for x in (low, high))
        except ValueError:
            raise ConfigError(f"bounds must have shape () or ({m},), got {np.shape(low)}, {np.shape(high)}") from None
        if not (np.all(self.low >= -1) and np.all(self.high <= 1) and np.all(self.low < self.high)):
            raise ConfigError(f"bounds must satisfy -1 <= low < high <= 1, got {low!r} and {high!r}")
        s = settings
        shape = (s.restarts, s.samples, s.blocks, m)
        self._noise = NoiseBank(shape, _TABLES, s.colour, s.seed)
        self._starts = NoiseBank((s.restarts, s.blocks, m), _TABLES, max(2.0, s.colour), s.seed + 1)

    def plan(self, state: Any, cost: Cost, memory: PlanMemory | None = None) -> SampledPlan:
        """Find the cheapest plan.

        Parameters
        ----------
        state : (d,), or (E, d) for a batch of independent states.
        cost : cost of trajectories; its parameters may have an axis E.
        memory : `SampledPlan.memory` of the search in the last decision; None at the start of an episode.

        Raises
        ------
        ModelError, ConfigError
            If the state, or the result of the model or the cost, has a wrong shape.
        """
        begin = perf_counter()
        states, single = read_states(self.model, state)
        memory = self._memory(len(states), memory)
        search = self._search(states, cost, memory, begin)
        plan = self._answer(states, search, memory, begin)
        return plan.single() if single else plan

    def _memory(self, e: int, memory: PlanMemory | None) -> PlanMemory:
        s, m = self.settings, self.model.action_dim
        if memory is None:
            blank = np.zeros((e, s.blocks, m), np.float32)
            elites = np.zeros((e, s.elites, s.blocks, m), np.float32)
            return PlanMemory(blank, elites, np.zeros(e, np.int64), np.zeros(e, bool))
        if memory.mean.shape != (e, s.blocks, m) or memory.elites.shape != (e, s.elites, s.blocks, m):
            raise ConfigError(
                f"memory is of other plans: mean {memory.mean.shape}, elites {memory.elites.shape}; this planner has "
                f"{(e, s.blocks, m)} and {(e, s.elites, s.blocks, m)}"
            )
        return memory

    def _shift(self, plans: Any) -> Any:
        """Plans one decision later; the last block is repeated."""
        later = np.concatenate([plans[..., 1:, :], plans[..., -1:, :]], axis=-2)
        return plans + (later - plans) / np.float32(self.settings.hold)

    def _search(self, states: Any, cost: Cost, memory: PlanMemory, begin: float) -> _Search:
        s, e = self.settings, len(states)
        mean = 0.5 * np.clip(self._starts.take(memory.count), -2, 2)
        mean[:, 0] = 0.0
        std = np.full_like(mean, s.std)
        kept = np.empty((e, s.restarts, 0, *mean.shape[2:]), np.float32)
        if s.warm:
            mean[:, 0] = np.where(memory.warm[:, None, None], self._shift(memory.mean), mean[:, 0])
        found = _Search(e, s.elites)
        slowest = 0.0
        for i, n in enumerate(s.sizes()):
            now = perf_counter()
            if i and s.time_limit is not None and now - begin + slowest > s.time_limit:
                found.limited = True
                break
            noise = self._noise.take(memory.count * s.iterations + i)[:, :, :n]
            samples = mean[:, :, None] + std[:, :, None] * noise
            samples[:, :, 0] = mean
            samples = np.concatenate([samples, kept], axis=2)
            if i == 0 and s.warm and s.kept:
                samples[:, 0, 1 : s.kept + 1] = np.where(
                    memory.warm[:, None, None, None],
                    self._shift(memory.elites[:, : s.kept]),
                    samples[:, 0, 1 : s.kept + 1],
                )
            samples = np.clip(samples, self.low, self.high)
            flat = samples.reshape(e, -1, *samples.shape[3:])
            costs, reached = evaluate(self.model, cost, states, flat, s.grid)
            elites, elite_costs = _cheapest(samples, costs.reshape(samples.shape[:3]), s.elites)
            found.add(flat, costs, reached, elites, elite_costs)
            new_mean, new_std = self.update(elites, elite_costs, std)
            usable = np.isfinite(elite_costs).any(axis=-1)[..., None, None]
            mean = np.where(usable, s.momentum * mean + (1 - s.momentum) * new_mean, mean)
            std = np.where(usable, np.maximum(s.momentum * std + (1 - s.momentum) * new_std, s.min_std), std)
            kept = elites[:, :, : s.kept]
            slowest = max(slowest, perf_counter() - now)
        if s.answer == "mean":
            last = np.clip(mean[np.arange(e), found.winner], self.low, self.high)[:, None]
            costs, reached = evaluate(self.model, cost, states, last, s.grid)
            found.settle(last[:, 0], costs[:, 0], reached[:, 0])
        return found

    def _answer(self, states: Any, search: _Search, memory: PlanMemory, begin: float) -> SampledPlan:
        e, bad = len(states), ~np.isfinite(search.cost)
        inputs = np.where(bad[:, None, None], np.float32(0), search.inputs)
        action = inputs[:, 0].copy()
        if bad.any():
            fallback_action = np.zeros_like(action) if self.fallback is None else np.asarray(self.fallback(states))
            fallback_action = np.where(np.isfinite(fallback_action), fallback_action, 0.0)
            action[bad] = np.clip(fallback_action, self.low, self.high)[bad]
            inputs[bad] = action[bad][:, None]
        usual = PlanStatus.TIME_LIMIT if search.limited else PlanStatus.PLANNED
        return SampledPlan(
            action=action,
            inputs=inputs,
            trajectory=np.where(bad[:, None, None], np.nan, search.trajectory),
            cost=search.cost,
            elites=search.elites,
            elite_costs=search.elite_costs,
            status=tuple(PlanStatus.FALLBACK if b else usual for b in bad),
            iterations=search.iterations,
            time=perf_counter() - begin,
            memory=PlanMemory(inputs.copy(), search.elites.copy(), memory.count + 1, ~bad & np.ones(e, bool)),
        )


class _Search:
    """The best plans so far, for each of E states."""

    def __init__(self, e: int, elites: int) -> None:
        self._rows, self._count = np.arange(e), elites
        self.cost = np.full(e, np.inf)
        self.iterations, self.limited = 0, False
        self.winner = np.zeros(e, np.int64)
        self.inputs: Any = None
        self.trajectory: Any = None
        self.elites: Any = None
        self.elite_costs: Any = None

    def add(self, flat: Any, costs: Any, reached: Any, elites: Any, elite_costs: Any) -> None:
        """Add an iteration: samples (E, S, B, m), their costs and states, the elites (E, R, K, B, m)."""
        self.iterations += 1
        best = costs.argmin(axis=1)
        cost, inputs, trajectory = costs[self._rows, best], flat[self._rows, best], reached[self._rows, best]
        if self.inputs is None:
            self.cost, self.inputs, self.trajectory = cost, inputs, trajectory
        else:
            better = cost < self.cost
            self.cost = np.where(better, cost, self.cost)
            self.inputs = np.where(better[:, None, None], inputs, self.inputs)
            self.trajectory = np.where(better[:, None, None], trajectory, self.trajectory)
        self.winner = elite_costs[..., 0].argmin(axis=1)
        self.elites, self.elite_costs = elites[self._rows, self.winner], elite_costs[self._rows, self.winner]

    def settle(self, inputs: Any, costs: Any, reached: Any) -> None:
        """Replace the result by these plans (E, B, m) where their cost is finite."""
        good = np.isfinite(costs)
        self.cost = np.where(good, costs, self.cost)
        self.inputs = np.where(good[:, None, None], inputs, self.inputs)
        self.trajectory = np.where(good[:, None, None], reached, self.trajectory)


def _cheapest(samples: Any, costs: Any, count: int) -> tuple[Any, Any]:
    """The `count` cheapest plans of each restart, the cheapest first: (E, R, K, B, m) and (E, R, K)."""
    order = np.argsort(costs, axis=-1, kind="stable")[..., :count]
    return np.take_along_axis(samples, order[..., None, None], axis=2), np.take_along_axis(costs, order, axis=-1)


class CEM(SamplingPlanner):
    """The Cross-Entropy Method; plain, improved or with several restarts, by `PlannerSettings`.

    Examples
    --------
    >>> from dynamics.learned.models.bicycle import BicycleModel
    >>> planner = CEM(BicycleModel(), PlannerSettings.multistart())
    >>> start = np.array([0.0, 0, 0, 0, 1, 0])
    >>> plan = planner.plan(start, lambda t: np.hypot(t.states[..., -1, 0] - 20, t.states[..., -1, 1] - 3))
    >>> plan.status[0].name, bool(plan.cost < 0.5)
    ('PLANNED', True)
    """

    def __init__(
        self,
        model: StepModel,
        settings: PlannerSettings | None = None,
        fallback: Fallback | None = None,
        low: Any = -1.0,
        high: Any = 1.0,
    ) -> None:
        super().__init__(model, settings or PlannerSettings.multistart(), Eliting(), fallback, low, high)
