"""Strips: the lanes that a vehicle may come to be on, and the band across each in which its body is.

Notation
--------
x [m] is the way that a vehicle has driven from where it is now; at the start of the strip's lane it is between `NEAR`
and `FAR`, which are negative where that lies behind, and which differ where lanes do not meet in a point. So the
vehicle is on the lane at an s between x_least - FAR and x_most - NEAR.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import inlined, uncounted
from dynamics.road_networks.geometry.lanes import Lanes
from dynamics.road_networks.geometry.layout import AMPLITUDE, CIRCULAR, PULSATION, RADIUS, SHAPE, SINE
from dynamics.state import FloatArray, IntArray, Vehicle

__all__ = [
    "ALWAYS",
    "BACK",
    "BEFORE",
    "FAR",
    "FRONT",
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
    "front_of",
    "half_of",
    "is_dead_end",
    "keep_of",
    "steepness",
    "stopping_way",
]

NEAR, FAR, LOW, HIGH, HALF, START, BACK, KEEP, FRONT = range(9)
"""Columns of the strips' numbers [m]: the way to the start of the lane, at least and at most; the band across it; half
of the body along it, wherever in the band it comes to be; the least s of the middle of the body; the way after which it
is back in the middle of its lanes, which has come from beside them; half of the band in which it is then; and how far
the front is before the middle, as the body is now and somewhat askew: so far it stays behind where it owes that."""
STRIP = 9
SEVERAL = -2
"""Stands for several strips that lead to one."""
ALWAYS = 1e9
"""Stands for as far as the road goes [m]."""
BEFORE = 3.0
"""So far before the start of the next lane one may begin to turn into it [m]."""

_LENGTH, _WIDTH = int(Vehicle.LENGTH), int(Vehicle.WIDTH)
_LAP = 250.0
"""Passes over a lane that begin within this are kept apart [m]."""
_ROUNDING = 1e-11
"""Strips that differ by less are the same one [m]; less than `shield.certificate.network.monitor` permits a frame."""
_DRIFT = 6.0
"""How far out of the middle of an arc one drifts, times its radius [m^2]."""
_ASKEW = 0.2
"""How far the heading of a body in its lane is off, at most, when it is reckoned with later [rad]."""


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
    front: float


def empty_strips(count: int) -> Strips:
    """Room for so many."""
    return Strips(np.zeros((count, 3), np.int64), np.zeros((count, STRIP)))


@uncounted
def curvature(lanes: Lanes, lane: int) -> float:
    """Of an arc, 0 of other lanes [1/m]."""
    return 1 / lanes.rows[lane, RADIUS] if lanes.ids[lane, SHAPE] == CIRCULAR else 0.0


@uncounted
def steepness(lanes: Lanes, lane: int) -> float:
    """The greatest slope of a sine against the line that it winds around, 0 of other lanes."""
    return abs(lanes.rows[lane, AMPLITUDE] * lanes.rows[lane, PULSATION]) if lanes.ids[lane, SHAPE] == SINE else 0.0


@uncounted
def bulge(lanes: Lanes, lane: int, row: FloatArray) -> float:
    """How much further a body reaches across a lane that bends than across a straight one, if it points along it [m].

    On an arc that is by its corners. On a sine with the greatest slope m and the pulsation w it is by half its width
    times sqrt(1 + m^2 (1 - u^2)) - 1, since r is measured across the line that the sine winds around, and by its
    corners m w u L^2 / 8, where u is between 0 at the steepest place and 1 where the sine turns.
    """
    slope, long, half = steepness(lanes, lane), row[_LENGTH], 0.5 * row[_WIDTH]
    if slope == 0.0:
        return curvature(lanes, lane) * long * long / 8
    corners, widest = slope * abs(lanes.rows[lane, PULSATION]) * long * long / 8, math.sqrt(1 + slope * slope)
    u = min(corners * widest / (slope * math.hypot(half * slope, corners)), 1.0)
    return half * (math.sqrt(widest * widest - slope * slope * u * u) - 1) + corners * u


@uncounted
def keep_of(lanes: Lanes, lane: int, row: FloatArray, conduct: Conduct) -> float:
    """How far a body reaches to either side that keeps to the middle of a lane; on an arc it drifts, too [m]."""
    return 0.5 * row[_WIDTH] + conduct.sway + bulge(lanes, lane, row) + curvature(lanes, lane) * _DRIFT


@inlined
def front_of(row: FloatArray) -> float:
    """How far ahead of its middle a body reaches on a straight road, as askew as it may be later [m]."""
    return 0.5 * (row[_LENGTH] + row[_WIDTH] * _ASKEW)


@uncounted
def half_of(lanes: Lanes, lane: int, row: FloatArray, conduct: Conduct) -> float:
    """How far ahead of its middle, or behind it, a body reaches along a lane, at most, that keeps to its middle [m].

    On an arc a body near the edge towards the centre takes more of the lane's length than of its own.
    """
    long, wide = row[_LENGTH], row[_WIDTH]
    askew = min(_ASKEW + math.atan(steepness(lanes, lane)), math.atan2(wide, long))
    half = max(front_of(row), 0.5 * (long * math.cos(askew) + wide * math.sin(askew)))
    bend = curvature(lanes, lane)
    if bend == 0.0:
        return half
    return math.atan2(half, 1 / bend - 0.5 * wide - conduct.sway - bend * _DRIFT) / bend


@inlined
def is_dead_end(ways: Ways, lane: int) -> bool:
    """Whether no lane goes on from the end of a lane. A vehicle drives straight off that end, and s counts on."""
    return ways.after.shape[1] == 0 or ways.after[lane, 0] < 0


@inlined
def stopping_way(row: FloatArray, conduct: Conduct) -> float:
    """No less than what a vehicle drives until it stands, braking as hard as it may [m], at any frame rate."""
    v = max(row[3], 0.0)
    return v * v / (2 * conduct.braking) + v


@inlined
def _repeats(row: FloatArray, strip: Strip, stop: float) -> bool:
    """Whether a strip, a later pass over the lane of another, lies within that at all times: the vehicle never leaves
    the start of the other for sure, since it may stop before."""
    within = row[FAR] + row[START] >= stop and strip.near >= row[NEAR] and strip.start >= row[START] - _ROUNDING
    within = within and row[LOW] <= strip.low + _ROUNDING and row[HIGH] >= strip.high - _ROUNDING
    within = within and row[HALF] >= strip.half - _ROUNDING and row[FRONT] >= strip.front - _ROUNDING
    centred = max(strip.high, -strip.low) <= row[KEEP] + _ROUNDING
    return within and (centred or strip.back - strip.near <= row[BACK] - row[NEAR] + _ROUNDING)


@uncounted
def add(strips: Strips, first: int, count: int, strip: Strip, stop: float) -> int:
    """Write a strip down, where no other of the vehicle contains it; how many there are then. `stop` is the
    `stopping_way` of the vehicle."""
    marks, numbers = strips.marks, strips.numbers
    for j in range(first, min(count, len(marks))):
        if marks[j, 1] != strip.lane:
            continue
        row = numbers[j]
        same = abs(row[NEAR] - strip.near) < _ROUNDING and abs(row[FAR] - strip.far) < _ROUNDING
        same = same and row[LOW] <= strip.low + _ROUNDING and row[HIGH] >= strip.high - _ROUNDING
        same = same and row[HALF] >= strip.half - _ROUNDING
        if same and marks[j, 2] >= 0 and marks[j, 2] != strip.parent:
            marks[j, 2] = SEVERAL
        if same or (strip.near > _LAP and _repeats(row, strip, stop)):
            return count
    if count < len(marks):
        marks[count, 0], marks[count, 1], marks[count, 2] = strip.vehicle, strip.lane, strip.parent
        numbers[count, NEAR], numbers[count, FAR] = strip.near, strip.far
        numbers[count, LOW], numbers[count, HIGH] = strip.low, strip.high
        numbers[count, HALF], numbers[count, START] = strip.half, strip.start
        numbers[count, BACK], numbers[count, KEEP], numbers[count, FRONT] = strip.back, strip.keep, strip.front
    return count + 1
