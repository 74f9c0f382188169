r"""Costs of plans, composed of small objects.

Notation
--------
E states, S plans, T evaluated states (see `mpc.sampling.plan.Trajectories`). A *term* gives a cost to every evaluated
state, c_i (E, S, T). A *factor* gives each a weight, w_j (E, S, T) or (T,). They are combined with `+`, and the cost of
a plan is

    sum_t  w_1 ... w_k (c_1 + ... + c_n)

>>> from mpc.tasks.parking_costs import GoalCost, SuccessMask
>>> goal = np.array([4.0, 14.0, 0.0, 0.0, 0.0, 1.0])
>>> cost = GoalCost(goal) + 0.5 * InputCost() + SuccessMask(goal) + TerminalWeight(5.0)
>>> len(cost.terms), len(cost.factors)
(2, 2)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from dynamics.errors import ConfigError
from mpc.sampling.plan import Trajectories

__all__ = ["DisagreementCost", "Factor", "InputCost", "SpeedCost", "Sum", "Term", "TerminalWeight", "TimeCost"]


class _Adds:
    """`+` and `*` of all terms and factors."""

    __slots__ = ()

    def __add__(self, other: Any) -> Sum:
        found: Sum = Sum.of(self) + other
        return found

    def __mul__(self, weight: float) -> Sum:
        return Sum.of(self) * weight

    __rmul__ = __mul__


class Term(_Adds):
    """Base class of a cost of each evaluated state."""

    __slots__ = ()

    def stages(self, trajectories: Trajectories) -> Any:
        """Costs, (E, S, T) or broadcastable to it."""
        raise NotImplementedError


class Factor(_Adds):
    """Base class of a weight of each evaluated state."""

    __slots__ = ()

    def weights(self, trajectories: Trajectories) -> Any:
        """Weights, (E, S, T) or broadcastable to it."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class Sum:
    """Weighted terms, and factors; callable as a `mpc.sampling.plan.Cost`."""

    terms: tuple[tuple[float, Term], ...] = ()
    factors: tuple[Factor, ...] = ()

    @classmethod
    def of(cls, part: Any) -> Sum:
        """A sum of one part.

        Raises
        ------
        ConfigError
            If the part is neither a term, a factor nor a sum.
        """
        if isinstance(part, Sum):
            return part
        if isinstance(part, Term):
            return cls(((1.0, part),))
        if isinstance(part, Factor):
            return cls((), (part,))
        raise ConfigError(f"a cost is made of Term, Factor and Sum, got {type(part).__name__}")

    def __add__(self, other: Any) -> Sum:
        other = Sum.of(other)
        return Sum(self.terms + other.terms, self.factors + other.factors)

    def __mul__(self, weight: float) -> Sum:
        """All terms times a number; factors are unchanged."""
        if not np.isfinite(weight):
            raise ConfigError(f"a cost's weight must be finite, got {weight!r}")
        return Sum(tuple((weight * w, term) for w, term in self.terms), self.factors)

    __rmul__ = __mul__

    def stages(self, trajectories: Trajectories) -> Any:
        """Weighted cost of each evaluated state, (E, S, T)."""
        total: Any = np.zeros(trajectories.states.shape[:3], trajectories.states.dtype)
        for weight, term in self.terms:
            part = term.stages(trajectories)
            total = total + (part if weight == 1.0 else weight * part)
        for factor in self.factors:
            total = total * factor.weights(trajectories)
        return total

    def __call__(self, trajectories: Trajectories) -> Any:
        """Cost of each plan, (E, S)."""
        return self.stages(trajectories).sum(axis=2)


@dataclass(frozen=True, slots=True)
class TerminalWeight(Factor):
    """Weight of the last evaluated state, as if it lasted for `weight` decisions."""

    weight: float = 1.0

    def weights(self, trajectories: Trajectories) -> Any:
        """Weights, (T,)."""
        out = np.ones(trajectories.states.shape[2], trajectories.states.dtype)
        out[-1] = self.weight / trajectories.spans[-1]
        return out


@dataclass(frozen=True, slots=True)
class InputCost(Term):
    """Squared norm of the inputs, for each decision."""

    def stages(self, trajectories: Trajectories) -> Any:
        """Costs, (E, S, T)."""
        return np.square(trajectories.actions).sum(axis=-1) * trajectories.spans


@dataclass(frozen=True, slots=True)
class SpeedCost(Term):
    """Squared difference of the speed from a target speed [m^2/s^2], for each decision.

    The states have the velocity in columns 2 and 3.
    """

    speed: float

    def stages(self, trajectories: Trajectories) -> Any:
        """Costs, (E, S, T)."""
        states = trajectories.states
        return np.square(np.hypot(states[..., 2], states[..., 3]) - self.speed) * trajectories.spans


class Disagreeing(Protocol):
    """A model with a measure of its uncertainty."""

    def disagreement(self, states: Any, actions: Any) -> Any:
        """Spread of its members' next states, (n, d), for states (n, d) and actions (n, m)."""
        ...


@dataclass(frozen=True, slots=True)
class DisagreementCost(Term):
    """Disagreement of the members of an ensemble, one decision ahead of each evaluated state.

    Attributes
    ----------
    model : the ensemble.
    scale : cost of a unit of each state variable, (d,) or a number.
    """

    model: Disagreeing
    scale: Any = 1.0

    def stages(self, trajectories: Trajectories) -> Any:
        """Costs, (E, S, T)."""
        t = trajectories
        e, s = t.states.shape[:2]
        first = np.broadcast_to(t.start[:, None, None], (e, s, 1, t.start.shape[-1]))
        before = np.concatenate([first, t.states[:, :, :-1]], axis=2)
        flat = self.model.disagreement(before.reshape(-1, before.shape[-1]), t.actions.reshape(-1, t.actions.shape[-1]))
        return (np.asarray(flat) * np.asarray(self.scale)).sum(axis=-1).reshape(t.states.shape[:3])


@dataclass(frozen=True, slots=True)
class TimeCost(Term):
    """Cost of 1 for each decision; with a success mask, the time to success."""

    def stages(self, trajectories: Trajectories) -> Any:
        """Costs, (T,)."""
        return trajectories.spans
