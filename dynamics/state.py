"""Named columns of the state arrays, and angle wrapping.

Notation
--------
World frame: x, y [m], heading psi [rad] from the x axis, as in highway-env.
Road frame: s [m] along the road, r [m] across it (positive towards higher lane indices),
heading [rad] relative to the road. On a straight road the two differ by a rigid motion.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "LEAST",
    "MOST",
    "BoolArray",
    "Float32Array",
    "FloatArray",
    "IntArray",
    "RoadState",
    "State",
    "Vehicle",
    "readable",
    "wrap_to_pi",
]

Float32Array = NDArray[np.float32]
FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]


class State(IntEnum):
    """Columns of a kinematic state in the world frame: [m], [m], [rad], [m/s]."""

    X = 0
    Y = 1
    HEADING = 2
    SPEED = 3


class RoadState(IntEnum):
    """Columns of a kinematic state in the road frame: [m], [m], [rad], [m/s]."""

    S = 0
    R = 1
    HEADING = 2
    SPEED = 3


class Vehicle(IntEnum):
    """Columns of a vehicle row: a state in the world frame, length [m], width [m], crashed (0 or 1)."""

    X = 0
    Y = 1
    HEADING = 2
    SPEED = 3
    LENGTH = 4
    WIDTH = 5
    CRASHED = 6


LEAST = (-1e7, -1e7, -1e6, -1e4, 0.0, 0.0, 0.0)
MOST = (1e7, 1e7, 1e6, 1e4, 1e4, 1e4, 1.0)
"""Bounds of the columns of `Vehicle`. Within them, sums and squares do not overflow and loops over them end."""


def readable(rows: FloatArray) -> BoolArray:
    """Whether each number of vehicle rows (..., 7) is finite and within `LEAST` and `MOST`; of the shape of the
    rows."""
    return np.asarray((rows >= LEAST) & (rows <= MOST))


def wrap_to_pi(angle: Any) -> Any:
    """Wrap angles [rad] to [-pi, pi); the same expression as highway-env, so that rounding agrees."""
    return ((angle + np.pi) % (2 * np.pi)) - np.pi
