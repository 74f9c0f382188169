r"""Point nearest to the origin of a plane under linear constraints: the filter's program for one input.

The problem
-----------
    min |z|^2   s.t.   values + slopes (z - at) >= 0,   low <= z <= high,   z in R^2

A strictly convex quadratic program in two unknowns. Its solution is the origin, the foot of the origin on one of the
lines, or an intersection of two lines; all of these are tried. (The set-up of an iterative solver, DAQP or OSQP, takes
longer than this.)

>>> import numpy as np
>>> at, box = np.zeros(2), np.ones(2)
>>> nearest(np.array([-0.5]), np.array([[-1.0, 0.0]]), at, -box, box).tolist()
[-0.5, 0.0]
>>> nearest(np.array([-3.0]), np.array([[-1.0, 0.0]]), at, -box, box) is None
True
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dynamics.compiled import compiled
from dynamics.state import FloatArray

__all__ = ["nearest"]

_FLAT = 1e-9
"""Slope below which a constraint does not depend on the point."""
_PARALLEL = 1e-9
"""Sine of the angle between two lines below which they count as parallel."""
_KEPT = 1e-9
"""Violation up to which rounding is the cause, times the slope."""


def nearest(values: FloatArray, slopes: FloatArray, at: FloatArray, low: FloatArray, high: FloatArray) -> Any:
    """Solve the problem of the module's docstring.

    Parameters
    ----------
    values : values of the constraints at the point `at`, (n,); values that are not finite are left out.
    slopes : gradients of the constraints, (n, 2).
    at, low, high : (2,); the box must contain a point.

    Returns
    -------
    The point (2,), or None if no point satisfies all constraints.
    """
    out = np.empty(2)
    return out if _solve(values, slopes, at, low, high, out) else None


@compiled
def _solve(values: Any, slopes: Any, at: Any, low: Any, high: Any, out: Any) -> bool:
    """Whether a feasible point exists; the nearest one is written to `out` (2,)."""
    n, count = values.shape[0], 0
    normals, offsets = np.empty((n + 4, 2)), np.empty(n + 4)
    for i in range(n):
        value, x, y = values[i], slopes[i, 0], slopes[i, 1]
        if not (math.isfinite(value) and math.isfinite(x) and math.isfinite(y)):
            continue
        # A constraint that holds in the whole box cannot be active inside it.
        across = min(x * (low[0] - at[0]), x * (high[0] - at[0])) + min(y * (low[1] - at[1]), y * (high[1] - at[1]))
        if value + across >= 0:
            continue
        size, offset = math.hypot(x, y), value - x * at[0] - y * at[1]
        if size < _FLAT:
            if offset < 0:
                return False
            continue
        normals[count, 0], normals[count, 1], offsets[count] = x / size, y / size, offset / size
        count += 1
    for i in range(2):
        for sign in (1.0, -1.0):
            normals[count, 0], normals[count, 1] = sign * (i == 0), sign * (i == 1)
            offsets[count] = -low[i] if sign > 0 else high[i]
            count += 1
    # Candidates: the origin, the feet of the origin on the lines, and intersections of two lines.
    best = np.inf
    for i in range(-1, count):
        for j in range(i, count) if i >= 0 else range(-1, 0):
            if i < 0:
                px, py = 0.0, 0.0
            elif i == j:
                px, py = -normals[i, 0] * offsets[i], -normals[i, 1] * offsets[i]
            else:
                ax, ay, bx, by = normals[i, 0], normals[i, 1], normals[j, 0], normals[j, 1]
                sine = ax * by - ay * bx
                if not abs(sine) > _PARALLEL:
                    continue
                px, py = (ay * offsets[j] - by * offsets[i]) / sine, (bx * offsets[i] - ax * offsets[j]) / sine
            far = px * px + py * py
            if not far < best:
                continue
            holds = True
            for k in range(count):
                if not normals[k, 0] * px + normals[k, 1] * py + offsets[k] >= -_KEPT:
                    holds = False
                    break
            if holds:
                best, out[0], out[1] = far, px, py
        if i < 0 and best < np.inf:
            return True
    return best < np.inf
