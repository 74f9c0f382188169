"""Distances between rotated rectangles, by shapely."""

from __future__ import annotations

import numpy as np
import shapely

from dynamics.state import FloatArray

__all__ = ["polygons", "separation"]

_X, _Y, _HEADING, _LENGTH, _WIDTH = 0, 1, 2, 4, 5
_CORNERS = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) / 2


def separation(first: FloatArray, second: FloatArray) -> FloatArray:
    """Distance between rectangles [m], (...); 0 if they overlap.

    Parameters
    ----------
    first, second : shape (..., 6), broadcastable: x, y [m] of the centre, heading [rad], (speed), length, width [m].

    Examples
    --------
    >>> one = np.array([0.0, 0.0, 0.0, 0.0, 5.0, 2.0])
    >>> float(separation(one, one + [8.0, 6.0, 0.0, 0.0, 0.0, 0.0]))
    5.0
    """
    distance: FloatArray = shapely.distance(polygons(first), polygons(second))
    return distance


def polygons(boxes: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.object_]]:
    """Outlines of rectangles (..., 6), see `separation`, as shapely's polygons, (...)."""
    along, across = np.moveaxis(_CORNERS * boxes[..., None, [_LENGTH, _WIDTH]], -1, 0)
    cos, sin = np.cos(boxes[..., _HEADING, None]), np.sin(boxes[..., _HEADING, None])
    x, y = boxes[..., _X, None] + cos * along - sin * across, boxes[..., _Y, None] + sin * along + cos * across
    found: np.ndarray[tuple[int, ...], np.dtype[np.object_]] = shapely.polygons(np.stack([x, y], axis=-1))
    return found
