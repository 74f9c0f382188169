r"""The nearest point of a plane to the origin that satisfies linear constraints: the filter's program in one input.

The problem
-----------
    min |z|^2   s.t.   values + slopes (z - at) >= 0,   low <= z <= high,   z in R^2

A strictly convex quadratic program in two unknowns. Its solution is the origin, or the foot of the origin on one of the
lines, or where two of them cross: all of these are tried at once. (A solver that iterates, DAQP or OSQP, needs longer
to be set up than this takes.)

>>> import numpy as np
>>> at, box = np.zeros(2), np.ones(2)
>>> nearest(np.array([-0.5]), np.array([[-1.0, 0.0]]), at, -box, box).tolist()
[-0.5, 0.0]
>>> nearest(np.array([-3.0]), np.array([[-1.0, 0.0]]), at, -box, box) is None
True
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from dynamics.state import FloatArray

__all__ = ["nearest"]

_FLAT = 1e-9
"""Slope below which a constraint does not depend on the point."""
_PARALLEL = 1e-9
"""Sine of the angle between two lines below which they do not cross."""
_KEPT = 1e-9
"""Violation that rounding may leave, times the slope."""


def nearest(values: FloatArray, slopes: FloatArray, at: FloatArray, low: FloatArray, high: FloatArray) -> Any:
    """Solve the problem above.

    Parameters
    ----------
    values : of the constraints at the point `at`, (n,); those that are not finite are left out.
    slopes : their gradients, (n, 2).
    at, low, high : (2,); the box must contain a point.

    Returns
    -------
    The point (2,), or None where none satisfies them all.
    """
    used = np.isfinite(values) & np.isfinite(slopes).all(axis=1)
    # What holds everywhere in the box cannot be met with equality inside it.
    least = values + np.minimum(slopes * (low - at), slopes * (high - at)).sum(axis=1)
    used &= ~(least >= 0)
    slopes = slopes[used]
    offsets = values[used] - slopes @ at
    normals = np.concatenate([slopes, _BOX])
    offsets = np.concatenate([offsets, -low, high])
    size = np.hypot(normals[:, 0], normals[:, 1])
    flat = size < _FLAT
    if flat.any():
        if (offsets[flat] < 0).any():
            return None
        normals, offsets, size = normals[~flat], offsets[~flat], size[~flat]
    normals, offsets = normals / size[:, None], offsets / size
    if not (offsets < 0).any():
        return np.zeros(2)
    i, j = _pairs(len(offsets))
    (ax, ay), (bx, by) = normals[i].T, normals[j].T
    sine = ax * by - ay * bx
    met = np.abs(sine) > _PARALLEL
    i, j, sine, ax, ay, bx, by = (x[met] for x in (i, j, sine, ax, ay, bx, by))
    crossings = np.stack([ay * offsets[j] - by * offsets[i], bx * offsets[i] - ax * offsets[j]], axis=1) / sine[:, None]
    points = np.concatenate([-normals * offsets[:, None], crossings])
    good = (points @ normals.T + offsets >= -_KEPT).all(axis=1)
    if not good.any():
        return None
    points = points[good]
    return points[np.square(points).sum(axis=1).argmin()]


_BOX = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])


@lru_cache(maxsize=64)
def _pairs(n: int) -> tuple[Any, Any]:
    return np.triu_indices(n, 1)
