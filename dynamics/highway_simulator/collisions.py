"""Collisions of bodies after a frame and in the next frame: highway-env's `handle_collisions`.

Pairs are checked in the order of their indices; of several impacts on a body, the last counts. Only pairs that are near
along x are checked. The others fail highway-env's distance check.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.arithmetic import dot2
from dynamics.highway_simulator.arrays import Machine
from dynamics.highway_simulator.layout import (
    CHECKS,
    COS,
    CRASHED,
    DIAGONAL,
    IMPACT_X,
    IMPACT_Y,
    IMPACTED,
    KIND,
    LENGTH,
    OBSTACLE,
    SIN,
    SPEED,
    WIDTH,
    X,
    Y,
)
from dynamics.state import FloatArray, IntArray

__all__ = ["BodiesByX", "collide"]

_SLACK = 1e-6
"""Margin of the search along x [m]; the check itself is exact."""


@kernel_no_refcount
def _outline(products: int, f: FloatArray, p: FloatArray, i: int, out: FloatArray) -> None:
    """The corners of a body, the first repeated, (5, 2) [m]."""
    c, s, length, width = f[COS, i], f[SIN, i], p[LENGTH, i] / 2, p[WIDTH, i] / 2
    for k in range(4):
        a = -length if k < 2 else length
        b = -width if k in (0, 3) else width
        out[k, 0] = dot2(products, c, a, -s, b) + f[X, i]
        out[k, 1] = dot2(products, s, a, c, b) + f[Y, i]
    out[4, 0], out[4, 1] = out[0, 0], out[0, 1]


@kernel_no_refcount
def _span(sums: int, polygon: FloatArray, nx: float, ny: float) -> tuple[float, float]:
    """The least and the greatest coordinate of a polygon along an axis."""
    low = high = dot2(sums, polygon[0, 0], nx, polygon[0, 1], ny)
    for k in range(1, 5):
        at = dot2(sums, polygon[k, 0], nx, polygon[k, 1], ny)
        low, high = min(low, at), max(high, at)
    return low, high


@kernel_no_refcount
def _between(low: float, high: float, other_low: float, other_high: float) -> float:
    """Gap between two intervals, negative if they overlap."""
    return other_low - high if low < other_low else low - other_high


@kernel_no_refcount
def _mean(polygon: FloatArray, axis: int) -> float:
    """Mean coordinate of the corners of a rectangle."""
    return (polygon[0, axis] + polygon[1, axis] + polygon[2, axis] + polygon[3, axis]) / 4


@kernel_no_refcount
def _intersect(sums: int, corners: FloatArray, ux: float, uy: float) -> tuple[bool, bool, float, float]:
    """Separating-axis test of two polygons, in highway-env's order and with its early exits.

    Returns
    -------
    Whether they intersect, whether they will after the first has moved by u relative to the other, and the translation
    that separates them.
    """
    a, b = corners[0], corners[1]
    touch, will, least, tx, ty = True, True, np.inf, 0.0, 0.0
    for which in range(2):
        for k in range(4):
            nx = -corners[which, k + 1, 1] + corners[which, k, 1]
            ny = corners[which, k + 1, 0] - corners[which, k, 0]
            size = math.sqrt(dot2(sums, nx, nx, ny, ny))
            nx /= size
            ny /= size
            low, high = _span(sums, a, nx, ny)
            other_low, other_high = _span(sums, b, nx, ny)
            if _between(low, high, other_low, other_high) > 0:
                touch = False
            shift = dot2(sums, nx, ux, ny, uy)
            if shift < 0:
                low += shift
            else:
                high += shift
            distance = _between(low, high, other_low, other_high)
            if distance > 0:
                will = False
            if not touch and not will:
                return False, False, 0.0, 0.0
            if abs(distance) < least:
                least = abs(distance)
                dx, dy = _mean(a, 0) - _mean(b, 0), _mean(a, 1) - _mean(b, 1)
                forward = dot2(sums, dx, nx, dy, ny) > 0
                tx, ty = (nx, ny) if forward else (-nx, -ny)
    return touch, will, least * tx, least * ty


@kernel_no_refcount
def _handle(
    how: tuple[int, int],
    f: FloatArray,
    g: IntArray,
    p: FloatArray,
    corners: FloatArray,
    pair: tuple[int, int],
    dt: float,
) -> None:
    """Check two bodies for a collision, and store the impacts that the next frame applies. `how` is
    `Machine.sums` and `Machine.products`."""
    (sums, products), (i, j) = how, pair
    _outline(products, f, p, i, corners[0])
    _outline(products, f, p, j, corners[1])
    ux = f[SPEED, i] * f[COS, i] * dt - f[SPEED, j] * f[COS, j] * dt
    uy = f[SPEED, i] * f[SIN, i] * dt - f[SPEED, j] * f[SIN, j] * dt
    touch, will, x, y = _intersect(sums, corners, ux, uy)
    if will:
        if g[KIND, j] == OBSTACLE:
            f[IMPACT_X, i], f[IMPACT_Y, i] = x, y
        else:
            f[IMPACT_X, i], f[IMPACT_Y, i] = x / 2, y / 2
            f[IMPACT_X, j], f[IMPACT_Y, j] = -x / 2, -y / 2
            g[IMPACTED, j] = 1
        g[IMPACTED, i] = 1
    if touch:
        g[CRASHED, i] = g[CRASHED, j] = 1


@kernel_inline
def _near(sums: int, f: FloatArray, p: FloatArray, i: int, j: int, dt: float) -> bool:
    """highway-env's distance check, which uses the speed of the first body only."""
    dx, dy = f[X, j] - f[X, i], f[Y, j] - f[Y, i]
    apart = math.sqrt(dot2(sums, dx, dx, dy, dy))
    return not apart > (p[DIAGONAL, i] + p[DIAGONAL, j]) / 2 + f[SPEED, i] * dt


class BodiesByX(NamedTuple):
    """The m bodies of one environment, (F, m), (G, m) and (P, m) (see `layout`), their order by x, and the number of
    vehicles among them."""

    f: FloatArray
    g: IntArray
    p: FloatArray
    order: IntArray
    vehicles: int


@kernel_no_refcount
def collide(machine: Machine, present: BodiesByX, corners: FloatArray, pairs: IntArray, dt: float) -> None:
    """Mark crashed bodies, and store the impacts that the next frame applies.

    Parameters
    ----------
    corners, pairs : buffers, (2, 5, 2) and (m (m - 1) / 2,), written.
    """
    f, g, p, order, vehicles = present
    sums, products = machine.sums, machine.products
    bodies, widest, fastest = len(order), 0.0, 0.0
    for i in range(bodies):
        widest = max(widest, p[DIAGONAL, i])
        fastest = max(fastest, f[SPEED, i])
    reach = widest + fastest * dt + _SLACK
    n = 0
    for k in range(bodies):
        for j in range(k + 1, bodies):
            if f[X, order[j]] - f[X, order[k]] > reach:
                break
            one, two = min(order[k], order[j]), max(order[k], order[j])
            if one >= vehicles or not (g[CHECKS, one] or g[CHECKS, two]) or not _near(sums, f, p, one, two, dt):
                continue
            pair, at = one * bodies + two, n
            while at > 0 and pairs[at - 1] > pair:
                pairs[at] = pairs[at - 1]
                at -= 1
            pairs[at] = pair
            n += 1
    for k in range(n):
        _handle((sums, products), f, g, p, corners, (pairs[k] // bodies, pairs[k] % bodies), dt)
