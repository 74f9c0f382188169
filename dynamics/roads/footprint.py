"""Extra size of a rectangle that contains a car in the frame of a curved road.

Notation
--------
A car of length l and width w [m] at (s, r) with heading psi [rad] relative to the path has, on a straight road, the
half extents

    h_along = l/2 |cos psi| + w/2 |sin psi|        h_across = l/2 |sin psi| + w/2 |cos psi|

On a bend of curvature k the ends of the car lie further out than its centre, and a metre of the car covers 1 / (1 - k
r) metres of the path. Seen from the centre of the bend, the car is a convex set: its greatest angle and its greatest
distance are at corners. Inwards no extra size is needed: a point at Y has r' <= Y for k > 0 (r' >= Y for k < 0),
because a step along the tangent leads away from the centre.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.errors import SceneError
from dynamics.roads.arcs import project
from dynamics.state import FloatArray

__all__ = ["bend_growth"]

_CORNERS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
_ORIGIN = np.zeros(3)


def bend_growth(length: Any, width: Any, heading: Any, r: Any, curvature: Any) -> tuple[FloatArray, FloatArray]:
    """Extra half extents (along, across) [m] that a road-frame rectangle needs to contain a car on a bend.

    Parameters
    ----------
    length, width : of the car [m].
    heading : of the car relative to the path [rad].
    r : lateral position of its centre [m].
    curvature : of the path [1/m], constant along the car. All five broadcast.

    Returns
    -------
    Additions to h_along, in metres of the path, and to h_across; not negative, and the least that suffice.

    Raises
    ------
    SceneError
        If the car reaches the centre of the bend.
    """
    length, width, heading, r, curvature = np.broadcast_arrays(
        *(np.asarray(value, dtype=float) for value in (length, width, heading, r, curvature))
    )
    a, b = length[..., None] / 2 * _CORNERS[:, 0], width[..., None] / 2 * _CORNERS[:, 1]
    cos, sin = np.cos(heading)[..., None], np.sin(heading)[..., None]
    x, y = a * cos - b * sin, r[..., None] + a * sin + b * cos
    h_along, h_across = np.abs(x).max(axis=-1), np.abs(y - r[..., None]).max(axis=-1)
    if np.any(curvature * r + np.abs(curvature) * np.hypot(h_along, h_across) >= 1):
        raise SceneError(
            f"a car reaches the centre of the bend: curvatures {curvature.min():.4g} to {curvature.max():.4g} 1/m, "
            f"r {r.min():.2f} to {r.max():.2f} m; valid are cars with curvature * r and its half diagonal below 1"
        )
    s, across = project(_ORIGIN, curvature[..., None], x, y)
    along = np.abs(s).max(axis=-1) - h_along
    across = np.abs(across - r[..., None]).max(axis=-1) - h_across
    return np.maximum(along, 0.0), np.maximum(across, 0.0)
