"""The limits that the rules of the road (`dynamics.traffic.rules_of_the_road`) put on the motion of a vehicle in a
frame."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from dynamics.state import FloatArray
from dynamics.traffic.assumptions import Assumptions

__all__ = ["ROUNDING", "MotionBounds", "MotionLimits", "bend_speed_of", "limits_of"]

ROUNDING = 1e-9
"""Bound on rounding errors of an acceleration, a speed or a distance [m/s^2, m/s, m]. No tolerance beyond it is given,
as tolerances of single frames would add up: the fail-safe is checked for every growth of a bound above it."""


class MotionBounds(NamedTuple):
    """The limits that `check_motions` checks, with the rounding tolerance.

    Attributes
    ----------
    braking, acceleration, power, fastest, reversing, slow : from `Assumptions` [m/s^2, m^2/s^3, m/s].
    period : time between the scenes [s], of `frames` frames. lap : length of a closed road, 0 of an open one [m].
    curvature : greatest of any path on the road [1/m]; 0 on a straight road. bend_speed : see `bend_speed_of`.
    """

    braking: float
    acceleration: float
    power: float
    fastest: float
    reversing: float
    slow: float
    period: float
    lap: float
    frames: float
    curvature: float
    bend_speed: float


class MotionLimits(NamedTuple):
    """What `check_motions` compares a motion with.

    Attributes
    ----------
    stretch : see `dynamics.traffic.occupancy_kernels.rear_of`. settings : the numbers of `Motion`.
    row : the limits, of `limits_of`.
    """

    stretch: FloatArray
    settings: FloatArray
    row: FloatArray


def bend_speed_of(a: Assumptions, curvature: float) -> float:
    """Speed up to which vehicles take bends of a curvature [1/m] [m/s]; 0 on a straight road."""
    return math.sqrt(a.bend_acceleration / curvature) if curvature > 0 else 0.0


@lru_cache(maxsize=16)
def limits_of(a: Assumptions, period: tuple[float, int], lap: float, curvature: float) -> FloatArray:
    """The limits that `check_motions` checks, (11,).

    Parameters
    ----------
    period : time between the scenes [s], and number of its frames. lap : length of a closed road, 0 of an open one [m].
    curvature : greatest of any path on the road [1/m]; 0 on a straight road.
    """
    limits = MotionBounds(
        a.braking + ROUNDING,
        a.acceleration + ROUNDING,
        a.power,
        a.max_speed,
        a.reversing_speed + ROUNDING,
        a.slow_speed,
        period[0],
        lap,
        period[1],
        curvature,
        bend_speed_of(a, curvature),
    )
    return np.array(limits, dtype=float)
