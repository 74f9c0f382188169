"""Dead-end table (transposition table): states from which a depth-first search has found no continuation. A search that
reaches such a state again gives it up at once.

A depth-first search reaches about the same state again and again by other actions, and a blocked ego remains blocked
there. That is no proof, since the other vehicles may respond differently to those actions. So the search may miss a
sequence, but it never finds one that does not exist.
"""

from __future__ import annotations

from dynamics.compiled import kernel_no_refcount
from dynamics.highway_simulator.layout import SPEED, TARGET, TARGET_SPEED, X, Y
from shield.certificate.simulated.traffic import ego_in
from shield.certificate.simulated.workspace import TrafficSearch

__all__ = ["add_dead_end", "clear_dead_ends", "is_dead_end_state"]

_NEAR, _AS_FAST = 1.0, 0.5
"""Tolerances within which two states count as the same: distance along each axis [m], and speed [m/s]."""


@kernel_no_refcount
def is_dead_end_state(search: TrafficSearch, k: int) -> bool:
    """Whether future k, after k decisions, is close to a dead end."""
    f, ego, states = search.futures.f[k], ego_in(search, k), search.dead_ends.states[k]
    lane = search.futures.g[k, TARGET, ego]
    for i in range(min(search.dead_ends.counts[k], states.shape[0])):
        here = abs(states[i, 0] - f[X, ego]) < _NEAR and abs(states[i, 1] - f[Y, ego]) < _NEAR
        bound = states[i, 3] == lane and states[i, 4] == f[TARGET_SPEED, ego]
        if here and bound and abs(states[i, 2] - f[SPEED, ego]) < _AS_FAST:
            return True
    return False


@kernel_no_refcount
def add_dead_end(search: TrafficSearch, k: int) -> None:
    """Store future k as a dead end."""
    f, ego, dead_ends = search.futures.f[k], ego_in(search, k), search.dead_ends
    row = dead_ends.states[k, dead_ends.counts[k] % dead_ends.states.shape[1]]
    dead_ends.counts[k] += 1
    row[0], row[1], row[2] = f[X, ego], f[Y, ego], f[SPEED, ego]
    row[3], row[4] = search.futures.g[k, TARGET, ego], f[TARGET_SPEED, ego]


@kernel_no_refcount
def clear_dead_ends(search: TrafficSearch) -> None:
    """Clear the dead-end table; call when the root state or the clearance threshold changes."""
    for k in range(search.dead_ends.counts.shape[0]):
        search.dead_ends.counts[k] = 0
