r"""Circular arcs and straight pieces: places on them, projection onto them, and biarcs that join two poses.

Notation
--------
A *pose* is (x, y, theta): position [m] and direction [rad] at the start of a piece. Its curvature k [1/m] is positive
where the piece turns towards positive r, and 0 on a straight piece. On it, (s, r) is the arc length from the start
and the distance across, both [m]. With the coordinates (X, Y) of a point in the frame of the start,

    s = atan2(k X, 1 - k Y) / k                     r = (2 Y - k (X^2 + Y^2)) / (1 + sqrt((1 - k Y)^2 + (k X)^2))
    X = s sinc(k s / 2) cos(k s / 2) - r sin(k s)   Y = s sinc(k s / 2) sin(k s / 2) + r cos(k s)

Neither r, X nor Y has a singularity at k = 0; s has its limit X / (1 - k Y) there. Source: geometry of the circle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.state import FloatArray, wrap_to_pi

__all__ = ["STRAIGHT", "Arcs", "biarc", "place", "project"]

STRAIGHT = 1e-12
"""Curvature below which a piece counts as straight [1/m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Arcs:
    """Consecutive pieces of a path.

    Attributes
    ----------
    poses : start of each piece, shape (pieces, 3): x, y [m], direction [rad].
    curvatures : shape (pieces,) [1/m].
    lengths : shape (pieces,) [m].
    """

    poses: FloatArray
    curvatures: FloatArray
    lengths: FloatArray

    @classmethod
    def join(cls, parts: list[Arcs]) -> Arcs:
        """Concatenate several sequences of pieces."""
        return cls(
            np.concatenate([p.poses for p in parts]),
            np.concatenate([p.curvatures for p in parts]),
            np.concatenate([p.lengths for p in parts]),
        )


def place(poses: FloatArray, curvatures: Any, s: Any, r: Any) -> FloatArray:
    """Poses (..., 3) of the points (s, r) [m] of pieces given by `poses` (..., 3) and `curvatures` (...) [1/m]."""
    half = 0.5 * curvatures * s
    chord = s * np.sinc(half / np.pi)
    direction = poses[..., 2] + half
    heading = direction + half
    return np.stack(
        np.broadcast_arrays(
            poses[..., 0] + chord * np.cos(direction) - r * np.sin(heading),
            poses[..., 1] + chord * np.sin(direction) + r * np.cos(heading),
            heading,
        ),
        axis=-1,
    )


def project(poses: FloatArray, curvatures: Any, x: Any, y: Any) -> tuple[FloatArray, FloatArray]:
    """(s, r) [m] of world points x, y [m] on pieces given by `poses` (..., 3) and `curvatures` (...) [1/m].

    s is that of the place nearest to the start of the piece: |s| <= pi / |k|.
    """
    dx, dy = x - poses[..., 0], y - poses[..., 1]
    cos, sin = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    along, across = cos * dx + sin * dy, cos * dy - sin * dx
    rest = 1 - curvatures * across
    straight = np.abs(curvatures) < STRAIGHT
    safe = np.where(straight, 1.0, curvatures)
    s = np.where(straight, along, np.arctan2(curvatures * along, rest) / safe)
    r = (2 * across - curvatures * (along**2 + across**2)) / (1 + np.hypot(rest, curvatures * along))
    return s, r


def biarc(start: FloatArray, end: FloatArray) -> Arcs:
    """Two arcs that lead from pose `start` (..., 3) to pose `end` (..., 3) without a kink.

    Returns
    -------
    The first and the second arc of each pair, in this order: with n pairs, 2 n pieces in a row.

    Source: the biarc with equal tangent lengths (Bolton 1975): d solves 2 (1 - t1 t2) d^2 + 2 v (t1 + t2) d = v v.
    """
    start, end = np.atleast_2d(start), np.atleast_2d(end)
    v = end[:, :2] - start[:, :2]
    t1 = np.stack([np.cos(start[:, 2]), np.sin(start[:, 2])], axis=-1)
    t2 = np.stack([np.cos(end[:, 2]), np.sin(end[:, 2])], axis=-1)
    vv, vt = (v * v).sum(axis=-1), (v * (t1 + t2)).sum(axis=-1)
    # The form of the root without cancellation is exact also where the two directions agree.
    d = (vv / (vt + np.sqrt(vt**2 + 2 * (1 - (t1 * t2).sum(axis=-1)) * vv)))[:, None]
    middle = (start[:, :2] + d * t1 + end[:, :2] - d * t2) / 2
    k1, l1, turn = _arc_to(start, middle)
    joint = np.column_stack([middle, start[:, 2] + turn])
    k2, l2, _ = _arc_to(joint, end[:, :2])
    return Arcs(
        np.stack([start, joint], axis=1).reshape(-1, 3),
        np.stack([k1, k2], axis=1).reshape(-1),
        np.stack([l1, l2], axis=1).reshape(-1),
    )


def _arc_to(poses: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Curvature [1/m], length [m] and turn [rad] of the arc from each pose (n, 3) to each point (n, 2)."""
    delta = points - poses[:, :2]
    chord = np.hypot(delta[:, 0], delta[:, 1])
    half = wrap_to_pi(np.arctan2(delta[:, 1], delta[:, 0]) - poses[:, 2])
    length = chord / np.sinc(half / np.pi)
    return 2 * half / length, length, 2 * half
