"""Distances between rotated rectangles, batched: footprints where no road gives a frame to compare them in."""

from __future__ import annotations

import numpy as np

from dynamics.state import BoolArray, FloatArray

__all__ = ["separation"]

_X, _Y, _HEADING, _LENGTH, _WIDTH = 0, 1, 2, 4, 5


def separation(first: FloatArray, second: FloatArray) -> FloatArray:
    """Distance between rectangles [m], shape (...); 0 where they overlap.

    Parameters
    ----------
    first, second : shape (..., 6), broadcastable: x, y [m] of the centre, heading [rad], (speed), length, width [m].

    Two convex shapes that do not overlap are nearest at a corner of one of them; they overlap unless one of the four
    directions of their sides separates them.

    Examples
    --------
    >>> one = np.array([0.0, 0.0, 0.0, 0.0, 5.0, 2.0])
    >>> float(separation(one, one + [8.0, 6.0, 0.0, 0.0, 0.0, 0.0]))
    5.0
    """
    first, second = np.broadcast_arrays(first, second)
    one, two = _corners_seen_from(first, second), _corners_seen_from(second, first)
    half_1, half_2 = first[..., [_LENGTH, _WIDTH]] / 2, second[..., [_LENGTH, _WIDTH]] / 2
    apart = np.logical_or(_separated(one, half_2), _separated(two, half_1))
    distance = np.minimum(_to_box(one, half_2), _to_box(two, half_1))
    return np.where(apart, distance, 0.0)


def _corners_seen_from(box: FloatArray, other: FloatArray) -> FloatArray:
    """The corners of one rectangle in the frame of the other, shape (..., 4, 2) [m]."""
    signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) / 2
    local = signs * box[..., None, [_LENGTH, _WIDTH]]
    offset = _turn(box[..., :_HEADING] - other[..., :_HEADING], -other[..., _HEADING])
    turn = box[..., _HEADING] - other[..., _HEADING]
    return offset[..., None, :] + _turn(local, turn[..., None])


def _turn(points: FloatArray, angle: FloatArray) -> FloatArray:
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = points[..., _X], points[..., _Y]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def _separated(corners: FloatArray, half: FloatArray) -> BoolArray:
    """Whether a side of the box with these half extents (..., 2) has all corners beyond it."""
    beyond: BoolArray = (corners.min(axis=-2) > half) | (corners.max(axis=-2) < -half)
    return np.asarray(beyond.any(axis=-1))


def _to_box(corners: FloatArray, half: FloatArray) -> FloatArray:
    """Distance of the nearest corner to the box around the origin [m]."""
    outside = np.maximum(np.abs(corners) - half[..., None, :], 0.0)
    return np.asarray(np.hypot(outside[..., 0], outside[..., 1]).min(axis=-1))
