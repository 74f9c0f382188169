"""Who is next ahead and behind on a lane, as highway-env's `neighbour_vehicles` has it.

A body counts on every lane whose edges it is less than a metre beyond. Of two that are equally far ahead the later
counts, of two behind the earlier; one that is level counts as ahead.
"""

from __future__ import annotations

from dynamics.compiled import uncounted
from dynamics.highway_simulator.layout import ON, X
from dynamics.state import FloatArray, IntArray

__all__ = ["find", "sort"]


@uncounted
def sort(f: FloatArray, order: IntArray) -> bool:
    """Put bodies in order of x, and of their index where x is the same; whether any two are level.

    Parameters
    ----------
    order : (m,) bodies, nearly in order already; changed.
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


@uncounted
def _level(f: FloatArray, g: IntArray, front: IntArray, rear: IntArray) -> None:
    """`find` where some bodies are level: everybody is asked."""
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


@uncounted
def find(f: FloatArray, g: IntArray, order: IntArray, level: bool, front: IntArray, rear: IntArray) -> None:
    """The next body ahead of each body on each lane, and behind; -1 for nobody.

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
