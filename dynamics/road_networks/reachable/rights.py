"""Right of way on a road network: highway-env's priorities, or else an order that follows from the shape of the
roads."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from dynamics.compiled import kernel_no_refcount
from dynamics.road_networks.reachable.strips import SEVERAL, LaneContinuations
from dynamics.state import IntArray

__all__ = ["right_of_way_by_lane", "right_of_way_by_strip"]

_LEAST = -(1 << 20)
"""Less than any right of way."""


def right_of_way_by_lane(priorities: IntArray, ways: LaneContinuations) -> IntArray:
    """Right of way in each lane of a network, (n,): of two vehicles that would meet, the one with less waits.

    Where the lanes' `priorities`, (n,), as `RegulatedRoad` uses them, differ, they are the result. Where all are equal,
    lanes of a ring get 1, lanes that end beside a neighbouring lane get -1, and all others 0. So a vehicle that enters
    a roundabout waits for those in it, and a merging vehicle waits for those on the main road.
    """
    if np.ptp(priorities) > 0:
        return priorities
    starts, places = np.nonzero(ways.after >= 0)
    links = csr_array((np.ones(len(starts)), (starts, ways.after[starts, places])), shape=(len(ways.after),) * 2)
    _, part = connected_components(links, connection="strong")
    in_ring = (np.bincount(part)[part] > 1).astype(np.int64)
    return in_ring - (ways.over >= 0)


@kernel_no_refcount
def _best_before(ways: LaneContinuations, marks: IntArray, ranks: IntArray, j: int) -> int:
    """The greatest right of way of the strips of the same vehicle that lead to strip j."""
    best = _LEAST
    for k in range(marks.shape[0]):
        if marks[k, 0] == marks[j, 0]:
            leads = ways.over[marks[k, 1]] == marks[j, 1]
            for lane in ways.after[marks[k, 1]]:
                leads = leads or lane == marks[j, 1]
            if leads:
                best = max(best, ranks[k])
    return best


@kernel_no_refcount
def right_of_way_by_strip(ways: LaneContinuations, rights: IntArray, marks: IntArray, ranks: IntArray) -> None:
    """Right of way of a vehicle at each strip, (count,), written: the least of the lanes on its way there. If several
    ways lead there, the best of them counts."""
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
