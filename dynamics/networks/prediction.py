"""Where others can be on a road network: any of the ways that it offers them, within bounds on how they drive.

Notation
--------
A *strip* is a lane that a vehicle may come to be on, with the band across it in which its body is. x [m] is the way
that a vehicle has driven from where it is now; at the start of the strip's lane it is between `NEAR` and `FAR`, which
are negative where that lies behind, and which differ where lanes do not meet in a point. So the vehicle is on the lane
at an s between x_least - FAR and x_most - NEAR.

Whoever is on a lane, or reaches into it, may follow it to its end, and any lane that goes on from there; whoever is
known to follow a route, only that. Nobody turns into a neighbouring lane that it does not touch yet: who does has
taken more room, and that is for `shield.roads.watch` to judge.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from dynamics.compiled import uncounted
from dynamics.networks.continuations import SETTLED
from dynamics.networks.lanes import Lanes, heading_at, local, place
from dynamics.networks.layout import AMPLITUDE, CIRCULAR, PULSATION, RADIUS, ROAD, SHAPE, SINE
from dynamics.simulator.arithmetic import wrap_to_pi
from dynamics.simulator.layout import LANE_LENGTH, LANE_LIMIT, LANE_WIDTH
from dynamics.state import FloatArray, IntArray, Vehicle

__all__ = [
    "ALWAYS",
    "BACK",
    "FAR",
    "HALF",
    "HIGH",
    "LOW",
    "NEAR",
    "START",
    "STRIP",
    "Conduct",
    "Ways",
    "reach",
    "spread",
]

NEAR, FAR, LOW, HIGH, HALF, START, BACK = range(7)
"""Columns of the strips' numbers [m]: the way to the start of the lane, at least and at most; the band across it; half
of the body along it; the least s of the middle of the body; and the way after which it is back in the middle of its
lanes, which has come from beside them."""
STRIP = 7
ALWAYS = 1e9
"""Stands for as far as the road goes [m]."""

_LENGTH, _WIDTH, _CRASHED = int(Vehicle.LENGTH), int(Vehicle.WIDTH), int(Vehicle.CRASHED)
_ASKEW = 0.2
"""How far the heading of a body in its lane is off, at most, when it is reckoned with later [rad]."""
_ALIGNED, _TURNING, _OVERLAY = 0.5, 0.9, 2.0
"""A vehicle may follow a lane of another road if its heading is off by less than this [rad], or while it comes over to
it by less than that, and it is this near to the middle [m]: where roads part, that is true of several."""
_SWEEP = 0.5
"""How much further a body may reach that turns into a lane from beside it [m]."""
_STANDS = 0.5
"""Who is slower than that at the end of a lane waits until those beside it have gone by [m/s]."""
_BEFORE = 3.0
"""So far before the start of the next lane one may begin to turn into it [m]."""
_LAP = 250.0
"""Within this a vehicle may come by a second time [m]."""
_ROOM = 1e-6


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


@uncounted
def _curvature(lanes: Lanes, lane: int) -> float:
    return 1 / lanes.rows[lane, RADIUS] if lanes.ids[lane, SHAPE] == CIRCULAR else 0.0


@uncounted
def _add(
    marks: IntArray,
    numbers: FloatArray,
    first: int,
    count: int,
    vehicle: int,
    lane: int,
    near: float,
    far: float,
    low: float,
    high: float,
    half: float,
    start: float,
    back: float,
    parent: int,
) -> int:
    """Write a strip down, where no other of the vehicle contains it; how many there are then."""
    for j in range(first, count):
        if marks[j, 1] != lane:
            continue
        row = numbers[j]
        same = abs(row[NEAR] - near) < _ROOM and abs(row[FAR] - far) < _ROOM
        if near > _LAP or (same and row[LOW] <= low + _ROOM and row[HIGH] >= high - _ROOM):
            if marks[j, 2] != parent:
                marks[j, 2] = -1  # there is more than one way to it
            return count
    if count == len(marks):
        return count + 1
    marks[count, 0], marks[count, 1], marks[count, 2] = vehicle, lane, parent
    numbers[count, NEAR], numbers[count, FAR], numbers[count, LOW], numbers[count, HIGH] = near, far, low, high
    numbers[count, HALF], numbers[count, START], numbers[count, BACK] = half, start, back
    return count + 1


@uncounted
def spread(
    lanes: Lanes,
    ways: Ways,
    conduct: Conduct,
    rows: FloatArray,
    own: IntArray,
    routes: IntArray,
    marks: IntArray,
    numbers: FloatArray,
    drive: FloatArray,
) -> int:
    """All strips of all vehicles.

    Parameters
    ----------
    rows : of the vehicles, (m, 7). own : the lane that each is on, (m,).
    routes : for each road, 1 where it is on a vehicle's route, 2 where it is the last of it, (m, roads); all 0 of whom
        no route is known.
    marks, numbers : vehicle, lane, and the strip that leads to it, -1 where there is none or several, (room, 3), and
        the rest, (room, STRIP); written.
    drive : speed that it accelerates to [m/s], and the least and the greatest metres of s in a metre driven, (m, 3);
        written.

    Returns
    -------
    How many there are; more than `room` if there was not enough.
    """
    count, n = 0, lanes.rows.shape[0]
    for i in range(rows.shape[0]):
        first = count
        x, y, heading, length, width = rows[i, 0], rows[i, 1], rows[i, 2], rows[i, _LENGTH], rows[i, _WIDTH]
        road, routed = lanes.ids[own[i], ROAD], False
        for k in range(routes.shape[1]):
            routed = routed or routes[i, k] > 0
        # Lanes that it keeps to, or comes to from beside them; where there are none of its route, any such; and where
        # it is between lanes, those that its body touches.
        for again in range(5):
            if count > first or (again < 2 and not routed):
                continue
            for lane in range(n):
                if again < 2 and routes[i, lanes.ids[lane, ROAD]] == 0:
                    continue
                s, r = local(lanes, lane, x, y)
                long = lanes.rows[lane, LANE_LENGTH]
                within = ways.entries[lane, 0] - _BEFORE <= s <= long
                if again < 4 and not within:
                    continue
                angle = wrap_to_pi(heading - heading_at(lanes, lane, min(max(s, 0.0), long)))
                cos, sin, bend = abs(math.cos(angle)), abs(math.sin(angle)), _curvature(lanes, lane)
                bulge = bend * length * length / 8
                across = 0.5 * (length * sin + width * cos) + bulge
                keep = 0.5 * width + conduct.sway + bulge
                low, high, come = -keep, keep, again % 2 == 1 and lane != own[i]
                if again < 4 and not (again % 2 == 1 and lane == own[i]):
                    if come:
                        low, high = low + ways.entries[lane, 1], high + ways.entries[lane, 2]
                    if not (
                        abs(angle) <= (_TURNING if come else _ALIGNED) and r - across >= low and r + across <= high
                    ):
                        continue
                elif lane != own[i]:
                    beside = lanes.ids[lane, ROAD] == road
                    touches = abs(r) - across < lanes.rows[lane, LANE_WIDTH] / 2 - conduct.lean
                    inside = abs(r) <= _OVERLAY and within and abs(angle) <= _ALIGNED
                    if not ((beside and touches) or (not beside and inside)):
                        continue
                half = max(0.5 * (length * cos + width * sin), 0.5 * (length + width * _ASKEW))
                if come:
                    low, high = max(low, min(r - across - _SWEEP, -keep)), min(high, max(r + across + _SWEEP, keep))
                else:
                    low, high = min(r - across, -keep), max(r + across, keep)
                back = 0.0 if again % 2 == 0 and again < 4 else SETTLED
                count = _add(marks, numbers, first, count, i, lane, -s, -s, low, high, half, min(s, 0.0), back, -1)
                if count > len(marks):
                    return count
        at = first
        drive[i, 0], drive[i, 1], drive[i, 2] = 0.0, math.cos(_ALIGNED), 1.0
        while at < count:
            lane, row = marks[at, 1], numbers[at]
            limit, off = lanes.rows[lane, LANE_LIMIT], max(-row[LOW], row[HIGH]) - 0.5 * width
            drive[i, 0] = max(drive[i, 0], limit if limit < math.inf else conduct.top)
            share = min(_curvature(lanes, lane) * off, 0.5)
            drive[i, 1], drive[i, 2] = (
                min(drive[i, 1], math.cos(_ALIGNED) / (1 + share)),
                max(drive[i, 2], 1 / (1 - share)),
            )
            if lanes.ids[lane, SHAPE] == SINE:
                slope = abs(lanes.rows[lane, AMPLITUDE] * lanes.rows[lane, PULSATION])
                drive[i, 1] = min(drive[i, 1], math.cos(_ALIGNED) / math.sqrt(1 + slope * slope))
            beside = ways.over[lane]
            if beside >= 0 and rows[i, 3] > _STANDS:
                x0, y0 = place(lanes, lane, 0.0)
                at_s, at_r = local(lanes, beside, x0, y0)
                keep = 0.5 * width + conduct.sway
                low, high = min(-keep, row[LOW] + at_r), max(keep, row[HIGH] + at_r)
                near, far, back = row[NEAR] - at_s, row[FAR] - at_s, row[FAR] + lanes.rows[lane, LANE_LENGTH]
                start = row[START] + at_s
                count = _add(marks, numbers, first, count, i, beside, near, far, low, high, row[HALF], start, back, at)
                if count > len(marks):
                    return count
            known = routed and routes[i, lanes.ids[lane, ROAD]] < 2
            for again in range(2):
                some = False
                for k in range(ways.after.shape[1]):
                    after = ways.after[lane, k]
                    if after < 0:
                        break
                    if known and again == 0 and routes[i, lanes.ids[after, ROAD]] == 0:
                        continue
                    some, long, keep = True, lanes.rows[lane, LANE_LENGTH], 0.5 * width + conduct.sway
                    keep += _curvature(lanes, after) * length * length / 8
                    at_s, at_r, slack = ways.ends[lane, k, 0], ways.ends[lane, k, 1], ways.ends[lane, k, 2]
                    near, far, back = row[NEAR] + long - at_s - slack, row[FAR] + long - at_s + slack, row[BACK]
                    low, high = -keep, keep
                    if row[FAR] + long < row[BACK]:
                        low, high = min(low, row[LOW]), max(high, row[HIGH])
                    if slack > 0:
                        # Who has to come over from beside a lane does so in the course of it.
                        low, high = low + min(at_r, 0.0) - slack, high + max(at_r, 0.0) + slack
                        back = row[FAR] + long + SETTLED
                    start = at_s - _BEFORE
                    count = _add(
                        marks, numbers, first, count, i, after, near, far, low, high, row[HALF], start, back, at
                    )
                    if count > len(marks):
                        return count
                if some or not known:
                    break
            at += 1
    return count


@uncounted
def reach(
    conduct: Conduct, rows: FloatArray, drive: FloatArray, dt: float, least: FloatArray, most: FloatArray
) -> None:
    """How far each vehicle may have got by each frame, in metres of s: `least` and `most`, (m, K), from now on."""
    for i in range(rows.shape[0]):
        speed, wrecked = rows[i, 3], rows[i, _CRASHED] > 0
        slow, fast, back, ahead = speed, max(speed, 0.0), 0.0, 0.0
        if wrecked:
            slow = min(speed, 0.0)
        cap = max(drive[i, 0], fast)
        for k in range(least.shape[1]):
            least[i, k], most[i, k] = min(back * drive[i, 1], back * drive[i, 2]), ahead * drive[i, 2]
            back += slow * dt
            ahead += fast * dt
            slow = max(slow - conduct.braking * dt, 0.0) if slow > 0 else min(slow + conduct.braking * dt, 0.0)
            fast = min(fast + conduct.acceleration * dt, cap)
