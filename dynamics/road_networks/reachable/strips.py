"""Strips: the lanes that a vehicle may reach, each with the band across the lane in which its body is.

Notation
--------
x [m] is the distance that a vehicle has driven from its present place. At the start of the strip's lane, x is between
`NEAR` and `FAR`. They are negative if the start lies behind, and differ where lanes do not meet in a point. So the
vehicle is on the lane at an s between x_least - FAR and x_most - NEAR.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.layout import LANE_LENGTH
from dynamics.road_networks.geometry.lanes import NetworkLanes
from dynamics.road_networks.geometry.layout import AMPLITUDE, CIRCULAR, PULSATION, RADIUS, SHAPE, SINE
from dynamics.state import BoolArray, FloatArray, IntArray, Vehicle

__all__ = [
    "ALWAYS",
    "BODY_HALF",
    "CENTRED_FROM",
    "CENTRED_HALF",
    "FAR",
    "FRONT",
    "HIGH",
    "LOW",
    "NEAR",
    "SEVERAL",
    "START",
    "STRIP",
    "DrivingBounds",
    "LaneContinuations",
    "Strip",
    "Strips",
    "add",
    "body_front",
    "body_half",
    "bulge",
    "centred_half",
    "curvature",
    "empty_strips",
    "end_of_lane",
    "is_dead_end",
    "steepness",
    "stopping_distance_bound",
]

NEAR, FAR, LOW, HIGH, BODY_HALF, START, CENTRED_FROM, CENTRED_HALF, FRONT = range(9)
"""Columns of the strips' numbers [m].

NEAR, FAR: least and greatest distance to the start of the lane. LOW, HIGH: the band across the lane.
BODY_HALF: half of the body's extent along the lane, anywhere in the band. START: least s of the centre of the body.
CENTRED_FROM: distance after which a vehicle that entered from beside the lanes is back at their centre; CENTRED_HALF:
half of the band in which it is then.
FRONT: how far the front is ahead of the centre, the greater of its present value and `body_front`. A vehicle that has
to wait stays behind by this distance.
"""
STRIP = 9
SEVERAL = -2
"""Parent of a strip to which several strips lead."""
ALWAYS = 1e9
"""Stands for the whole length of the road [m]."""

_LENGTH, _WIDTH = int(Vehicle.LENGTH), int(Vehicle.WIDTH)
_LAP = 250.0
"""Passes over a lane that begin within this distance are kept as separate strips [m]."""
_ROUNDING = 1e-11
"""Strips that differ by less count as the same [m]. It is less than `shield.certificate.network.monitor` permits in a
frame."""
_DRIFT = 6.0
"""Lateral deviation of a vehicle from the centre of an arc, times the radius of the arc [m^2]."""
_ASKEW = 0.2
"""Greatest later deviation of a body's heading from that of its lane [rad]."""


class DrivingBounds(NamedTuple):
    """Bounds on how the others drive.

    Attributes
    ----------
    braking, acceleration : greatest [m/s^2]. top : greatest speed on a lane without a limit [m/s].
    lateral_deviation : greatest deviation of a body from the centre of its lane, beyond its own half width [m].
    marking_tolerance : how far it may reach over a marking before it counts as in the next lane [m].
    """

    braking: float
    acceleration: float
    top: float
    lateral_deviation: float
    marking_tolerance: float


class LaneContinuations(NamedTuple):
    """How the n lanes of a network continue.

    Attributes
    ----------
    after : the lanes that follow each lane, (n, most), -1 for none.
    ends : s and r on the following lane at which the lane ends, and the additional room where the joint is not
        smooth, (n, most, 3) [m].
    entries : least s, least r and greatest r at which vehicles enter each lane, (n, 3) [m].
    over : for a lane that ends, the neighbouring lane that a vehicle has to change to, (n,), -1 for none. A vehicle
        that changes there waits for no other.
    overruns : how far a vehicle may drive straight on past the end of each lane, (n,) [m].
    leads_off : whether a frame of straight motion past the end of each lane leads off the lanes that follow, (n,).
    bends_before : greatest curvature of the lanes that lead to each lane, (n,) [1/m].
    """

    after: IntArray
    ends: FloatArray
    entries: FloatArray
    over: IntArray
    overruns: FloatArray
    leads_off: BoolArray
    bends_before: FloatArray


class Strips(NamedTuple):
    """Buffer of strips.

    Attributes
    ----------
    marks : vehicle, lane, and parent strip, (room, 3). The parent is -1 for a lane that the vehicle is on now, and
        `SEVERAL` if several strips lead to this one.
    numbers : (room, STRIP), see `NEAR`.
    """

    marks: IntArray
    numbers: FloatArray


class Strip(NamedTuple):
    """One strip: a row of `Strips.marks` and of `Strips.numbers`."""

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
    """A buffer of `count` strips."""
    return Strips(np.zeros((count, 3), np.int64), np.zeros((count, STRIP)))


@kernel_no_refcount
def curvature(lanes: NetworkLanes, lane: int) -> float:
    """Curvature of an arc, 0 for other lanes [1/m]."""
    return 1 / lanes.rows[lane, RADIUS] if lanes.ids[lane, SHAPE] == CIRCULAR else 0.0


@kernel_no_refcount
def steepness(lanes: NetworkLanes, lane: int) -> float:
    """Greatest slope of a sine relative to the line that it winds around; 0 for other lanes."""
    return abs(lanes.rows[lane, AMPLITUDE] * lanes.rows[lane, PULSATION]) if lanes.ids[lane, SHAPE] == SINE else 0.0


@kernel_no_refcount
def bulge(lanes: NetworkLanes, lane: int, row: FloatArray) -> float:
    """How much further a body that points along a curved lane reaches across it than across a straight one [m].

    On an arc the corners reach further. On a sine, r is measured across the line that the sine winds around. With
    greatest slope m and pulsation w, half the width grows by the factor sqrt(1 + m^2 (1 - u^2)). The corners add m w u
    L^2 / 8. Here u is 0 at the steepest place and 1 where the sine turns.
    """
    slope, long, half = steepness(lanes, lane), row[_LENGTH], 0.5 * row[_WIDTH]
    if slope == 0.0:
        return curvature(lanes, lane) * long * long / 8
    corners, widest = slope * abs(lanes.rows[lane, PULSATION]) * long * long / 8, math.sqrt(1 + slope * slope)
    u = min(corners * widest / (slope * math.hypot(half * slope, corners)), 1.0)
    return half * (math.sqrt(widest * widest - slope * slope * u * u) - 1) + corners * u


@kernel_no_refcount
def centred_half(lanes: NetworkLanes, lane: int, row: FloatArray, bounds: DrivingBounds) -> float:
    """How far a body reaches to either side while it keeps to the centre of a lane, with the drift on an arc [m]."""
    return 0.5 * row[_WIDTH] + bounds.lateral_deviation + bulge(lanes, lane, row) + curvature(lanes, lane) * _DRIFT


@kernel_inline
def body_front(row: FloatArray) -> float:
    """How far a body reaches ahead of its centre on a straight road, at the greatest angle that it may have later
    [m]."""
    return 0.5 * (row[_LENGTH] + row[_WIDTH] * _ASKEW)


@kernel_no_refcount
def body_half(lanes: NetworkLanes, lane: int, row: FloatArray, bounds: DrivingBounds) -> float:
    """Greatest distance that a body at the centre of a lane reaches ahead of its own centre, or behind it, along the
    lane [m].

    On an arc, a body on the inner side covers more of the lane's length than its own.
    """
    long, wide = row[_LENGTH], row[_WIDTH]
    askew = min(_ASKEW + math.atan(steepness(lanes, lane)), math.atan2(wide, long))
    half = max(body_front(row), 0.5 * (long * math.cos(askew) + wide * math.sin(askew)))
    bend = curvature(lanes, lane)
    if bend == 0.0:
        return half
    return math.atan2(half, 1 / bend - 0.5 * wide - bounds.lateral_deviation - bend * _DRIFT) / bend


@kernel_inline
def is_dead_end(after: IntArray, lane: int) -> bool:
    """Whether no lane continues a lane, by `LaneContinuations.after`. A vehicle drives straight off its end, and s
    increases further."""
    return after.shape[1] == 0 or after[lane, 0] < 0


@kernel_inline
def end_of_lane(rows: FloatArray, after: IntArray, lane: int) -> float:
    """Greatest s of a place on a lane [m]: its length, `ALWAYS` for a dead end; `rows` as in `NetworkLanes`, `after` as
    in `LaneContinuations`."""
    return ALWAYS if is_dead_end(after, lane) else rows[lane, LANE_LENGTH]


@kernel_inline
def stopping_distance_bound(row: FloatArray, bounds: DrivingBounds) -> float:
    """Upper bound on the distance that a vehicle drives until it stands, at its hardest braking and any frame rate
    [m]."""
    v = max(row[3], 0.0)
    return v * v / (2 * bounds.braking) + v


@kernel_inline
def _contains(row: FloatArray, strip: Strip) -> bool:
    """Whether the body of a strip is within that of another, at each distance from the start of the lane."""
    within = strip.start >= row[START] - _ROUNDING
    within = within and row[LOW] <= strip.low + _ROUNDING and row[HIGH] >= strip.high - _ROUNDING
    within = within and row[BODY_HALF] >= strip.half - _ROUNDING and row[FRONT] >= strip.front - _ROUNDING
    centred = max(strip.high, -strip.low) <= row[CENTRED_HALF] + _ROUNDING
    return within and (centred or strip.back - strip.near <= row[CENTRED_FROM] - row[NEAR] + _ROUNDING)


@kernel_inline
def _repeats(row: FloatArray, strip: Strip, stop: float) -> bool:
    """Whether a strip, a later pass over the lane of another, lies within that one at all times. The vehicle may stop
    before it leaves the start of the other, so that one remains reachable."""
    return row[FAR] + row[START] >= stop and strip.near >= row[NEAR] and _contains(row, strip)


@kernel_no_refcount
def add(strips: Strips, first: int, count: int, strip: Strip, stop: float) -> int:
    """Store a strip, unless another strip of the vehicle contains it. `stop` is the `stopping_distance_bound` of the
    vehicle.

    Returns
    -------
    The number of strips.
    """
    marks, numbers = strips.marks, strips.numbers
    for j in range(first, min(count, len(marks))):
        if marks[j, 1] != strip.lane:
            continue
        row = numbers[j]
        same = abs(row[NEAR] - strip.near) < _ROUNDING and abs(row[FAR] - strip.far) < _ROUNDING
        same = same and row[LOW] <= strip.low + _ROUNDING and row[HIGH] >= strip.high - _ROUNDING
        same = same and row[BODY_HALF] >= strip.half - _ROUNDING
        if same and strip.parent > j:
            # The strips that strip j leads to are stored already, so it may not change.
            same = _contains(row, strip)
        if same:
            row[START], row[FRONT] = min(row[START], strip.start), max(row[FRONT], strip.front)
            row[CENTRED_FROM] = max(row[CENTRED_FROM], strip.back)
        if same and marks[j, 2] >= 0 and marks[j, 2] != strip.parent:
            marks[j, 2] = SEVERAL
        if same or (strip.near > _LAP and _repeats(row, strip, stop)):
            return count
    if count < len(marks):
        marks[count, 0], marks[count, 1], marks[count, 2] = strip.vehicle, strip.lane, strip.parent
        numbers[count, NEAR], numbers[count, FAR] = strip.near, strip.far
        numbers[count, LOW], numbers[count, HIGH] = strip.low, strip.high
        numbers[count, BODY_HALF], numbers[count, START] = strip.half, strip.start
        numbers[count, CENTRED_FROM], numbers[count, CENTRED_HALF], numbers[count, FRONT] = (
            strip.back,
            strip.keep,
            strip.front,
        )
    return count + 1
