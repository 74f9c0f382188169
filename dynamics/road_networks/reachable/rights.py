"""Who has the right of way on a road network: highway-env's priorities, or what the shape of the roads says."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from dynamics.compiled import uncounted
from dynamics.road_networks.reachable.strips import SEVERAL, Ways
from dynamics.state import IntArray

__all__ = ["ranks_of", "rights_of"]

_LEAST = -(1 << 20)
"""Less right of way than there is."""


def rights_of(priorities: IntArray, ways: Ways) -> IntArray:
    """How much right of way one has in each lane of a network, (n,): of two who meet, the one with less waits.

    These are the lanes' `priorities`, (n,), as `RegulatedRoad` has them, where they differ. Where all are the same, a
    lane of a ring, from which one may come back to it, has 1, one that ends and has to be left for its neighbour -1,
    and the rest have 0: who enters a roundabout waits for those in it, and who merges for those who stay.
    """
    if np.ptp(priorities) > 0:
        return priorities
    starts, places = np.nonzero(ways.after >= 0)
    links = csr_array((np.ones(len(starts)), (starts, ways.after[starts, places])), shape=(len(ways.after),) * 2)
    _, part = connected_components(links, connection="strong")
    in_ring = (np.bincount(part)[part] > 1).astype(np.int64)
    return in_ring - (ways.over >= 0)


@uncounted
def _best_before(ways: Ways, marks: IntArray, ranks: IntArray, j: int) -> int:
    best = _LEAST
    for k in range(marks.shape[0]):
        if marks[k, 0] == marks[j, 0]:
            leads = ways.over[marks[k, 1]] == marks[j, 1]
            for lane in ways.after[marks[k, 1]]:
                leads = leads or lane == marks[j, 1]
            if leads:
                best = max(best, ranks[k])
    return best


@uncounted
def ranks_of(ways: Ways, rights: IntArray, marks: IntArray, ranks: IntArray) -> None:
    """The right of way that a vehicle has before each strip, (count,), written: the least of the lanes on its way;
    where several ways lead there, that of the best one."""
    for j in range(marks.shape[0]):
        ranks[j] = rights[marks[j, 1]] if marks[j, 2] == -1 else _LEAST
    changed = True
    while changed:
        changed = False
        for j in range(marks.shape[0]):
            own, before = rights[marks[j, 1]], _LEAST
            if marks[j, 2] >= 0:
                before = ranks[marks[j, 2]]
            elif marks[j, 2] == SEVERAL:
                before = _best_before(ways, marks, ranks, j)
            if min(own, before) > ranks[j]:
                ranks[j], changed = min(own, before), True
