"""The next vehicles ahead and behind on a lane: highway-env's `neighbour_vehicles`.

A body counts on every lane if it is within the lane or at most a metre beyond its edges. Of two bodies equally far
ahead the one with the higher index counts, of two equally far behind the one with the lower index. A body at the same x
counts as ahead.
"""

from __future__ import annotations

from dynamics.compiled import kernel_no_refcount
from dynamics.highway_simulator.layout import ON, X
from dynamics.state import FloatArray, IntArray

__all__ = ["find", "sort"]


@kernel_no_refcount
def sort(f: FloatArray, order: IntArray) -> bool:
    """Sort bodies by x, and by index at equal x.

    Parameters
    ----------
    order : (m,) bodies, nearly sorted already; changed.

    Returns
    -------
    Whether two bodies have the same x.
    """
    level = False
    for k in range(1, len(order)):
        body = order[k]
        x, j = f[X, body], k - 1
        while j >= 0 and (f[X, order[j]] > x or (f[X, order[j]] == x and order[j] > body)):
            level = level or f[X, order[j]] == x
            order[j + 1] = order[j]
            j -= 1
        order[j + 1] = body
        if j >= 0 and f[X, order[j]] == x:
            level = True
    return level


@kernel_no_refcount
def _level(f: FloatArray, g: IntArray, front: IntArray, rear: IntArray) -> None:
    """`find` where some bodies have the same x: all pairs are compared."""
    for lane in range(len(front)):
        for i in range(front.shape[1]):
            ahead, behind, x = -1, -1, f[X, i]
            for v in range(front.shape[1]):
                if v == i or not (g[ON, v] >> lane) & 1:
                    continue
                if x <= f[X, v] and (ahead < 0 or f[X, v] <= f[X, ahead]):
                    ahead = v
                if f[X, v] < x and (behind < 0 or f[X, v] > f[X, behind]):
                    behind = v
            front[lane, i], rear[lane, i] = ahead, behind


@kernel_no_refcount
def find(f: FloatArray, g: IntArray, order: IntArray, level: bool, front: IntArray, rear: IntArray) -> None:
    """The next body ahead of each body on each lane, and the next behind; -1 for none.

    Parameters
    ----------
    order, level : of `sort`. front, rear : (lanes, m), written.
    """
    if level:
        _level(f, g, front, rear)
        return
    bodies = len(order)
    for lane in range(len(front)):
        last = -1
        for k in range(bodies - 1, -1, -1):
            body = order[k]
            front[lane, body] = last
            last = body if (g[ON, body] >> lane) & 1 else last
        last = -1
        for k in range(bodies):
            body = order[k]
            rear[lane, body] = last
            last = body if (g[ON, body] >> lane) & 1 else last
