"""Observations of the ego: highway-env's Kinematics observation."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.arithmetic import clip, dot2, wrap_to_pi
from dynamics.highway_simulator.arrays import Bodies, ObservationConfig, Work
from dynamics.highway_simulator.layout import COS, HEADING, KIND, LANE, LANE_Y, LENGTH, OBSTACLE, SIN, SPEED, X, Y
from dynamics.highway_simulator.random import GeneratorRow, interval
from dynamics.state import FloatArray, IntArray

__all__ = ["FEATURES", "feature_of", "kinematics"]

FEATURES = (
    "presence",
    "x",
    "y",
    "vx",
    "vy",
    "heading",
    "cos_h",
    "sin_h",
    "cos_d",
    "sin_d",
    "long_off",
    "lat_off",
    "ang_off",
)
"""Features of a body. Destinations are unknown on a highway: cos_d and sin_d are 0."""

_SIGHT = 200.0
"""`PERCEPTION_DISTANCE` [m]."""
_RELATIVE = 5
"""Features with a lower index than this, except presence, are relative to the ego."""


@kernel_inline
def feature_of(f: FloatArray, g: IntArray, lanes: FloatArray, i: int, feature: int) -> float:
    """A feature of a body, by its index in `FEATURES`."""
    if feature == 0:
        return 1.0
    if feature == 1:
        return f[X, i]
    if feature == 2:
        return f[Y, i]
    standing = g[KIND, i] == OBSTACLE
    if feature == 3:
        return 0.0 if standing else f[SPEED, i] * f[COS, i]
    if feature == 4:
        return 0.0 if standing else f[SPEED, i] * f[SIN, i]
    if feature == 6:
        return f[COS, i]
    if feature == 7:
        return f[SIN, i]
    if feature == 8 or feature == 9:
        return 0.0
    if standing:
        return math.nan
    if feature == 10:
        return f[X, i]
    if feature == 5:
        return f[HEADING, i]
    if feature == 11:
        return f[Y, i] - lanes[g[LANE, i], LANE_Y]
    return wrap_to_pi(f[HEADING, i] - 0.0)


@kernel_no_refcount
def _near(sums: int, bodies: Bodies, most: int, behind: bool, unsorted: bool, obstacles: bool, near: IntArray) -> int:
    """Up to `most` bodies within sight, by distance along the road unless `unsorted`: `near` (m,), written.

    Returns
    -------
    The number of bodies.
    """
    f, g, p = bodies.f, bodies.g, bodies.p
    n, x, y, back = 0, f[X, 0], f[Y, 0], -2 * p[LENGTH, 0]
    for i in range(1, f.shape[1]):
        dx, dy = f[X, i] - x, f[Y, i] - y
        standing = g[KIND, i] == OBSTACLE
        if standing and not obstacles:
            continue
        if not (math.sqrt(dot2(sums, dx, dx, dy, dy)) < _SIGHT and ((behind and not standing) or back < dx)):
            continue
        if unsorted:
            if n < most:
                near[n] = i
                n += 1
            continue
        k = n
        while k > 0 and abs(dx) < abs(f[X, near[k - 1]] - x):
            if k < most:
                near[k] = near[k - 1]
            k -= 1
        if k < most:
            near[k] = i
            n = min(n + 1, most)
    return n


@kernel_no_refcount
def kinematics(
    sums: int, row: GeneratorRow, bodies: Bodies, view: ObservationConfig, work: Work, out: NDArray[np.float32]
) -> None:
    """Write the ego and the bodies near it, nearest first, to `out`, (rows, features).

    Parameters
    ----------
    row : the random generator, for a shuffled order.
    view : `features`, indices in `FEATURES`; `ranges` (features, 2), the values mapped to -1 and 1, NaN for features
        that are not normalised; `switches`: absolute, normalised, clipped, vehicles behind, shuffled, obstacles.
    work : buffers; `busy` (m,) and `seen` (rows, features) are written.
    """
    absolute, normalised, clipped, behind, shuffled, obstacles = view.switches
    f, g, lanes, features, ranges = bodies.f, bodies.g, bodies.lanes, view.features, view.ranges
    near, seen, rows = work.busy, work.seen, len(out)
    n = _near(sums, bodies, rows - 1, behind, shuffled, obstacles, near)
    for k in range(rows):
        for c in range(len(features)):
            if k > n:
                seen[k, c] = 0.0
                continue
            i, feature = (0, features[c]) if k == 0 else (near[k - 1], features[c])
            value = feature_of(f, g, lanes, i, feature)
            if k > 0 and not absolute and 1 <= feature < _RELATIVE:
                value -= feature_of(f, g, lanes, 0, feature)
            if normalised and not math.isnan(ranges[c, 0]):
                value = -1 + (value - ranges[c, 0]) * 2 / (ranges[c, 1] - ranges[c, 0])
                if clipped:
                    value = clip(value, -1.0, 1.0)
            seen[k, c] = value
    if shuffled:
        for k in range(rows - 2, 0, -1):
            j = interval(row, k)
            if j != k:
                for c in range(len(features)):
                    seen[1 + k, c], seen[1 + j, c] = seen[1 + j, c], seen[1 + k, c]
    for k in range(rows):
        for c in range(len(features)):
            out[k, c] = np.float32(seen[k, c])
