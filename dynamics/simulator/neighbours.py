"""Who is next ahead and behind on a lane, as highway-env's `neighbour_vehicles` has it.

A body counts on every lane whose edges it is less than a metre beyond. Of two that are equally far ahead the later counts,
of two behind the earlier; one that is level counts as ahead.
"""

from __future__ import annotations

from dynamics.compiled import uncounted
from dynamics.simulator.layout import LANE_LENGTH, LANE_WIDTH, LANE_Y, X
from dynamics.state import FloatArray, IntArray

__all__ = ["ahead", "behind", "lanes_at", "sort"]

_MARGIN = 1.0
_OVERHANG = 5.0
"""`AbstractLane.VEHICLE_LENGTH`: a lane goes on for so long beyond both its ends [m]."""


@uncounted
def sort(f: FloatArray, order: IntArray, place: IntArray) -> bool:
    """Put bodies in order of x, and of their index where x is the same; whether any two are level.

    Parameters
    ----------
    order : (m,) bodies by place, nearly in order already; changed. place : (m,) its inverse; written.
    """
    level = False
    for k in range(1, len(order)):
        body = order[k]
        x, j = f[X, body], k - 1
        while j >= 0 and (f[X, order[j]] > x or (f[X, order[j]] == x and order[j] > body)):
            order[j + 1] = order[j]
            j -= 1
        order[j + 1] = body
    for k in range(len(order)):
        place[order[k]] = k
        if k > 0 and f[X, order[k]] == f[X, order[k - 1]]:
            level = True
    return level


@uncounted
def lanes_at(lanes: FloatArray, x: float, y: float) -> int:
    """The lanes that a body counts on, as bits."""
    bits = 0
    for lane in range(len(lanes)):
        if abs(y - lanes[lane, LANE_Y]) <= lanes[lane, LANE_WIDTH] / 2 + _MARGIN and (
            -_OVERHANG <= x < lanes[lane, LANE_LENGTH] + _OVERHANG
        ):
            bits |= 1 << lane
    return bits


@uncounted
def ahead(f: FloatArray, on: IntArray, order: IntArray, place: IntArray, level: bool, body: int, lane: int) -> int:
    """The next body ahead on a lane, or -1."""
    if level:
        found, x = -1, f[X, body]
        for v in range(len(on)):
            if v != body and (on[v] >> lane) & 1 and x <= f[X, v] and (found < 0 or f[X, v] <= f[X, found]):
                found = v
        return found
    for k in range(place[body] + 1, len(order)):
        if (on[order[k]] >> lane) & 1:
            return order[k]
    return -1


@uncounted
def behind(f: FloatArray, on: IntArray, order: IntArray, place: IntArray, level: bool, body: int, lane: int) -> int:
    """The next body behind on a lane, or -1."""
    if level:
        found, x = -1, f[X, body]
        for v in range(len(on)):
            if v != body and (on[v] >> lane) & 1 and f[X, v] < x and (found < 0 or f[X, v] > f[X, found]):
                found = v
        return found
    for k in range(place[body] - 1, -1, -1):
        if (on[order[k]] >> lane) & 1:
            return order[k]
    return -1
