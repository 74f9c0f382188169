"""Where a search in depth has found no way on: what comes about there again is given up at once.

A search that goes back and forth at the end of a long way comes to about the same place again and again by other
actions: whoever is blocked there is blocked there. It is no proof, since the others may have answered those actions
otherwise, so a way may be missed; none is found that is not there.
"""

from __future__ import annotations

from dynamics.compiled import uncounted
from dynamics.highway_simulator.layout import SPEED, TARGET, TARGET_SPEED, X, Y
from shield.certificate.simulated.traffic import ego_in
from shield.certificate.simulated.workspace import Search

__all__ = ["bury", "forget_dead", "is_dead"]

_NEAR, _AS_FAST = 1.0, 0.5
"""What is about the same: so far apart along each axis [m], and so much faster or slower [m/s]."""


@uncounted
def is_dead(search: Search, k: int) -> bool:
    """Whether future k, that of so many decisions, is about where no way was found that goes on."""
    f, ego, states = search.futures.f[k], ego_in(search, k), search.dead.states[k]
    lane = search.futures.g[k, TARGET, ego]
    for i in range(min(search.dead.buried[k], states.shape[0])):
        here = abs(states[i, 0] - f[X, ego]) < _NEAR and abs(states[i, 1] - f[Y, ego]) < _NEAR
        bound = states[i, 3] == lane and states[i, 4] == f[TARGET_SPEED, ego]
        if here and bound and abs(states[i, 2] - f[SPEED, ego]) < _AS_FAST:
            return True
    return False


@uncounted
def bury(search: Search, k: int) -> None:
    """Remember that no way goes on from future k."""
    f, ego, dead = search.futures.f[k], ego_in(search, k), search.dead
    row = dead.states[k, dead.buried[k] % dead.states.shape[1]]
    dead.buried[k] += 1
    row[0], row[1], row[2] = f[X, ego], f[Y, ego], f[SPEED, ego]
    row[3], row[4] = search.futures.g[k, TARGET, ego], f[TARGET_SPEED, ego]


@uncounted
def forget_dead(search: Search) -> None:
    """Of another present, or another floor."""
    for k in range(search.dead.buried.shape[0]):
        search.dead.buried[k] = 0
