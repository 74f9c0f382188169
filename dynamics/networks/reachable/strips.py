"""Strips: the lanes that a vehicle may come to be on, and the band across each in which its body is.

Notation
--------
x [m] is the way that a vehicle has driven from where it is now; at the start of the strip's lane it is between `NEAR`
and `FAR`, which are negative where that lies behind, and which differ where lanes do not meet in a point. So the
vehicle is on the lane at an s between x_least - FAR and x_most - NEAR.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.compiled import uncounted
from dynamics.networks.lanes import Lanes
from dynamics.networks.layout import CIRCULAR, RADIUS, SHAPE
from dynamics.state import FloatArray, IntArray, Vehicle

__all__ = [
    "ALWAYS",
    "BACK",
    "BEFORE",
    "FAR",
    "HALF",
    "HIGH",
    "KEEP",
    "LOW",
    "NEAR",
    "SEVERAL",
    "START",
    "STRIP",
    "Conduct",
    "Strip",
    "Strips",
    "Ways",
    "add",
    "bulge",
    "curvature",
    "empty_strips",
    "keep_of",
]

NEAR, FAR, LOW, HIGH, HALF, START, BACK, KEEP = range(8)
"""Columns of the strips' numbers [m]: the way to the start of the lane, at least and at most; the band across it; half
of the body along it; the least s of the middle of the body; the way after which it is back in the middle of its
lanes, which has come from beside them; and half of the band in which it is then."""
STRIP = 8
SEVERAL = -2
"""Stands for several strips that lead to one."""
ALWAYS = 1e9
"""Stands for as far as the road goes [m]."""
BEFORE = 3.0
"""So far before the start of the next lane one may begin to turn into it [m]."""

_LENGTH, _WIDTH = int(Vehicle.LENGTH), int(Vehicle.WIDTH)
_LAP = 250.0
"""Within this a vehicle may come by a second time [m]."""
_ROUNDING = 1e-6
_DRIFT = 6.0
"""How far out of the middle of an arc one drifts, times its radius [m^2]."""


class Conduct(NamedTuple):
    """How others drive.

    Attributes
    ----------
    braking, acceleration : the hardest [m/s^2]. top : the fastest where a lane has no limit [m/s].
    sway : how far out of the middle of its lane a body comes, beyond its own half width [m]. lean : how far it may
        reach over a marking before it counts as being in the next lane [m].
    """

    braking: float
    acceleration: float
    top: float
    sway: float
    lean: float


class Ways(NamedTuple):
    """Where one can go on a network of n lanes.

    Attributes
    ----------
    after : lanes that each leads to, (n, most), -1 for none. ends : where on them it ends, s and r, and how
        much more room it takes to come over, (n, most, 3) [m].
    entries : the least s, the least and the greatest r at which one comes into each, (n, 3) [m].
    over : the neighbour that one has to come over to from a lane that ends, (n,), -1 for none; who does that waits for
        nobody.
    """

    after: IntArray
    ends: FloatArray
    entries: FloatArray
    over: IntArray


class Strips(NamedTuple):
    """Room for strips.

    Attributes
    ----------
    marks : vehicle, lane, and the strip that leads to it, -1 where a vehicle is there now and `SEVERAL` where several
        do, (room, 3).
    numbers : (room, STRIP).
    """

    marks: IntArray
    numbers: FloatArray


class Strip(NamedTuple):
    """One strip: what `Strips.marks` and `Strips.numbers` have of it."""

    vehicle: int
    lane: int
    parent: int
    near: float
    far: float
    low: float
    high: float
    half: float
    start: float
    back: float
    keep: float


def empty_strips(count: int) -> Strips:
    """Room for so many."""
    return Strips(np.zeros((count, 3), np.int64), np.zeros((count, STRIP)))


@uncounted
def curvature(lanes: Lanes, lane: int) -> float:
    """Of an arc, 0 of other lanes [1/m]."""
    return 1 / lanes.rows[lane, RADIUS] if lanes.ids[lane, SHAPE] == CIRCULAR else 0.0


@uncounted
def bulge(lanes: Lanes, lane: int, row: FloatArray) -> float:
    """How much further the corners of a body reach on an arc [m]."""
    return curvature(lanes, lane) * row[_LENGTH] * row[_LENGTH] / 8


@uncounted
def keep_of(lanes: Lanes, lane: int, row: FloatArray, conduct: Conduct) -> float:
    """How far a body reaches to either side that keeps to the middle of a lane; on an arc it drifts, too [m]."""
    return 0.5 * row[_WIDTH] + conduct.sway + bulge(lanes, lane, row) + curvature(lanes, lane) * _DRIFT


@uncounted
def add(strips: Strips, first: int, count: int, strip: Strip) -> int:
    """Write a strip down, where no other of the vehicle contains it; how many there are then."""
    marks, numbers = strips.marks, strips.numbers
    for j in range(first, min(count, len(marks))):
        if marks[j, 1] != strip.lane:
            continue
        row = numbers[j]
        same = abs(row[NEAR] - strip.near) < _ROUNDING and abs(row[FAR] - strip.far) < _ROUNDING
        same = same and row[LOW] <= strip.low + _ROUNDING and row[HIGH] >= strip.high - _ROUNDING
        if same and marks[j, 2] >= 0 and marks[j, 2] != strip.parent:
            marks[j, 2] = SEVERAL
        # Who comes by after a lap has come by before.
        if same or strip.near > _LAP:
            return count
    if count < len(marks):
        marks[count, 0], marks[count, 1], marks[count, 2] = strip.vehicle, strip.lane, strip.parent
        numbers[count, NEAR], numbers[count, FAR] = strip.near, strip.far
        numbers[count, LOW], numbers[count, HIGH] = strip.low, strip.high
        numbers[count, HALF], numbers[count, START] = strip.half, strip.start
        numbers[count, BACK], numbers[count, KEEP] = strip.back, strip.keep
    return count + 1
