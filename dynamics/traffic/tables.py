"""What is known of the vehicles of a scene, as few arrays, and as names for their rows.

A compiled call takes a tenth of a microsecond for each array that it is handed, and three times as long for one inside
a tuple. So arrays with many rows go from call to call, and inside they get their names: `bodies_of`, `motion_of`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.compiled import inlined, numbers_of
from dynamics.state import FloatArray, IntArray

__all__ = ["Bodies", "Motion", "Tables", "bodies_of", "motion_of"]


class Bodies(NamedTuple):
    """Where each vehicle's body is and can come to be across the road, each (m,).

    `lane`: the nearest; `first`, `last`: the lanes that the body touches (first > last where it touches none);
    `low`, `high` [m]: outer edges of the lanes touched and of the body; `reach` [m]: half the length that the body
    covers along the road at any heading; `budget` [m], `action` [m^2/s]: what it may still lose of its way
    by turning, as such and times its speed, negative where it has lost more; `recent` [m^2/s]: what it has lost of
    the latter in each frame of the last second, (m, frames), the newest first; `swing`: how much more than a car it may
    lose; `brakes` (m, K) [m/s^2]: how hard it may brake at each of the coming frames, see `dynamics.traffic.reaction`;
    `floor` [m]: least s that its centre ever comes to; `noses` (2, m) [m]: greatest s of the body after one frame, and
    after two.
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

    `braking`, `acceleration` [m/s^2]; `power` [m^2/s^3]: acceleration times speed at most; `max_speed` [m/s] up to
    which anybody accelerates; `min_speed` [m/s] below which nobody brakes on purpose; `slow` [m/s] below which way is
    not counted; `loss` [m] and `action` [m^2/s]: what turning may cost a car, `loss_back` [m/s] and `action_back`
    [m^2/s^2]: how fast that comes back, and `burst` [m^2/s]: action within a second at most; `calm` [m/s^2]: braking
    that needs no reason; `reversing` [m/s]: greatest speed backwards; `queue` [m], `queue_speed` [m/s]: one reverses
    only from what is nearer than this ahead, centre to centre, and slower; `runout` [s], within which one that
    reverses comes to rest otherwise; `dt` [s].
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
    burst: float
    calm: float
    reversing: float
    queue: float
    queue_speed: float
    runout: float
    dt: float


class Tables(NamedTuple):
    """The arrays that `Bodies` are rows of: `marks` (3, m) of integers, `numbers` (9, m), `brakes` and `recent`."""

    marks: IntArray
    numbers: FloatArray
    brakes: FloatArray
    recent: FloatArray

    @classmethod
    def empty(cls, m: int, coming: int, past: int) -> Tables:
        """For m vehicles, with room for `coming` frames of braking and `past` frames of what was lost."""
        return cls(np.empty((3, m), np.intp), np.empty((9, m)), np.empty((m, coming)), np.zeros((m, past)))


@inlined
def bodies_of(marks: IntArray, numbers: FloatArray, brakes: FloatArray, recent: FloatArray) -> Bodies:
    """The rows of `Tables` by their names."""
    lane, first, last = marks[0], marks[1], marks[2]
    low, high, reach, budget, action = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]
    swing, floor, noses = numbers[5], numbers[6], numbers[7:9]
    return Bodies(lane, first, last, low, high, reach, budget, action, swing, brakes, recent, floor, noses)


@inlined
def motion_of(row: FloatArray) -> Motion:
    """The numbers of a `Motion`, (17,), by their names."""
    return Motion(*numbers_of(row, 17))
