"""Derived quantities of the vehicles of a scene, as a few arrays, and as NamedTuples of their rows.

A compiled call takes a tenth of a microsecond for each array argument, and three times as long for an array inside a
tuple. So kernels pass arrays with many rows. Inside a kernel, `bodies_of` and `motion_of` give the rows their names.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, row_as_tuple
from dynamics.state import FloatArray, IntArray

__all__ = [
    "Motion",
    "ReachableBodies",
    "Tables",
    "VehicleBodies",
    "VehicleTables",
    "bodies_in",
    "bodies_of",
    "motion_of",
]


class ReachableBodies(NamedTuple):
    """Reachable places of the bodies of m vehicles across and along the road.

    Attributes
    ----------
    lane : nearest lane, (m,).
    first, last : the lanes that the body touches, (m,); first > last if it touches none.
    low, high : outer edges of the lanes touched and of the body, (m,) [m].
    reach : half the length that the body covers along the road at any heading, (m,) [m].
    budget : distance that it may still lose by turning, (m,) [m]; negative if it has lost more than it may.
    action : the same, times its speed, (m,) [m^2/s].
    swing : factor on both allowances: 1 for a car, more for a longer vehicle, (m,).
    brakes : hardest braking at each of the coming frames, (m, K) [m/s^2]; see `dynamics.traffic.reaction`.
    recent : speed times distance lost in each frame of the last second, newest first, (m, frames) [m^2/s].
    floor : least s that its centre ever reaches, (m,) [m].
    noses : greatest s of the body after one frame, and after two, (2, m) [m].
    """

    lane: IntArray
    first: IntArray
    last: IntArray
    low: FloatArray
    high: FloatArray
    reach: FloatArray
    budget: FloatArray
    action: FloatArray
    swing: FloatArray
    brakes: FloatArray
    recent: FloatArray
    floor: FloatArray
    noses: FloatArray


class Motion(NamedTuple):
    """Bounds on the motion along the road.

    Attributes
    ----------
    braking, acceleration : greatest [m/s^2].
    power : greatest product of acceleration and speed [m^2/s^3].
    max_speed : greatest speed that a vehicle accelerates to [m/s].
    min_speed : speed below which no vehicle brakes on purpose [m/s].
    slow : speed below which no progress is assumed [m/s].
    loss, action : what turning may cost a car: distance [m], and speed times distance [m^2/s].
    loss_back, action_back : rates at which these recover [m/s], [m^2/s^2].
    action_in_one_second : greatest `action` within a second [m^2/s].
    comfortable_braking : braking that needs no reason [m/s^2].
    reversing : greatest speed backwards [m/s].
    queue, queue_speed : a vehicle reverses only behind one that is nearer than this, centre to centre [m], and slower
        than this [m/s].
    runout : time within which a vehicle that reverses otherwise comes to rest [s].
    dt : duration of a frame [s].
    """

    braking: float
    acceleration: float
    power: float
    max_speed: float
    min_speed: float
    slow: float
    loss: float
    action: float
    loss_back: float
    action_back: float
    action_in_one_second: float
    comfortable_braking: float
    reversing: float
    queue: float
    queue_speed: float
    runout: float
    dt: float


class Tables(NamedTuple):
    """The arrays that hold the fields of `ReachableBodies`: `marks` (3, m) of integers, `numbers` (9, m), `brakes` and
    `recent`."""

    marks: IntArray
    numbers: FloatArray
    brakes: FloatArray
    recent: FloatArray

    @classmethod
    def empty(cls, m: int, coming: int, past: int) -> Tables:
        """Tables for m vehicles, with `coming` frames of braking and `past` frames of `recent`."""
        return cls(np.empty((3, m), np.intp), np.empty((9, m)), np.empty((m, coming)), np.zeros((m, past)))


class VehicleTables(NamedTuple):
    """The other vehicles of a scene as arrays: vehicle rows (m, 7), road states (m, 4), tables."""

    others: FloatArray
    states: FloatArray
    tables: Tables


class VehicleBodies(NamedTuple):
    """The same inside a kernel: vehicle rows (m, 7), road states (m, 4), reachable places of the bodies."""

    rows: FloatArray
    states: FloatArray
    bodies: ReachableBodies


@kernel_inline
def bodies_of(marks: IntArray, numbers: FloatArray, brakes: FloatArray, recent: FloatArray) -> ReachableBodies:
    """Name the rows of `Tables`."""
    lane, first, last = marks[0], marks[1], marks[2]
    low, high, reach, budget, action = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]
    swing, floor, noses = numbers[5], numbers[6], numbers[7:9]
    return ReachableBodies(lane, first, last, low, high, reach, budget, action, swing, brakes, recent, floor, noses)


@kernel_inline
def bodies_in(vehicles: VehicleTables) -> VehicleBodies:
    """Name the rows of the tables of a scene."""
    tables = vehicles.tables
    bodies = bodies_of(tables.marks, tables.numbers, tables.brakes, tables.recent)
    return VehicleBodies(vehicles.others, vehicles.states, bodies)


@kernel_inline
def motion_of(row: FloatArray) -> Motion:
    """Name the numbers of a `Motion`, (17,)."""
    return Motion(*row_as_tuple(row, 17))
