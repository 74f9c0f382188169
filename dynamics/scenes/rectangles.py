"""Gaps between rotated rectangles, batched: a moving one against standing ones.

Notation
--------
World frame. The moving rectangle has centre p, heading psi, half extents (a, b) along and across u = (cos psi, sin
psi); a standing one has centre q, heading phi, half extents (c, d) along and across w = (cos phi, sin phi). With D = p
- q, C = |cos(psi - phi)| and S = |sin(psi - phi)|, the gaps along the four directions of their sides are

    |D . u|  - a - c C - d S          |D . w|  - c - a C - b S
    |D . u'| - b - c S - d C          |D . w'| - d - a S - b C

where u', w' are u, w turned by 90 degrees. The greatest of them is the *gap*. Two rectangles are apart exactly if it is
positive (separating axes). Their distance is at least the gap. The two are equal unless a corner is nearest to a
corner; then the gap is at least 1 / sqrt(2) of the distance. Source: S. Gottschalk, M. Lin, D. Manocha, OBBTree,
SIGGRAPH 1996.

The *coming gap* is the gap after the moving rectangle has swept t u, t = v dt: along a direction n, |D . n| becomes |D
. n + t u . n / 2| - |t u . n| / 2. Source: `utils.are_polygons_intersecting` of highway-env 1.12. It counts a collision
when this is not positive, as if the coming frame went straight along the heading.
"""

from __future__ import annotations

import numpy as np

from dynamics.state import FloatArray, State

__all__ = ["gaps"]

_X, _Y, _HEADING, _LENGTH, _WIDTH = range(5)


def gaps(states: FloatArray, size: tuple[float, float], boxes: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
    """Gap and coming gap between a vehicle and rectangles [m].

    Parameters
    ----------
    states : of the vehicle, columns `State`, world frame, (..., 4).
    size : its length and width [m].
    boxes : rectangles, (m, 5): x, y [m] of the centre, heading [rad], length, width [m].
    dt : duration of the coming frame [s].

    Returns
    -------
    The gap (..., m), not positive where they touch, and the coming gap (..., m), which is never greater.

    Examples
    --------
    >>> wall = np.array([[10.0, 0.0, 0.0, 1.0, 40.0]])
    >>> now, coming = gaps(np.array([0.0, 0.0, 0.0, 30.0]), (5.0, 2.0), wall, 0.1)
    >>> now.tolist(), coming.tolist()
    ([7.0], [4.0])
    """
    half, other = (0.5 * size[0], 0.5 * size[1]), 0.5 * boxes[:, _LENGTH : _WIDTH + 1].T
    psi, phi = states[..., State.HEADING, None], boxes[:, _HEADING]
    dx, dy = states[..., State.X, None] - boxes[:, _X], states[..., State.Y, None] - boxes[:, _Y]
    ux, uy, wx, wy = np.cos(psi), np.sin(psi), np.cos(phi), np.sin(phi)
    cos, sin = ux * wx + uy * wy, uy * wx - ux * wy
    c, s = np.abs(cos), np.abs(sin)
    sweep = 0.5 * dt * states[..., State.SPEED, None]
    beside = np.abs(dy * ux - dx * uy) - half[1] - other[0] * s - other[1] * c
    now, coming = beside, beside
    for way, ahead, reach in (
        (dx * ux + dy * uy, sweep, half[0] + other[0] * c + other[1] * s),
        (dx * wx + dy * wy, sweep * cos, other[0] + half[0] * c + half[1] * s),
        (dy * wx - dx * wy, sweep * sin, other[1] + half[0] * s + half[1] * c),
    ):
        now = np.maximum(now, np.abs(way) - reach)
        coming = np.maximum(coming, np.abs(way + ahead) - np.abs(ahead) - reach)
    return now, coming
