"""Where others can be on a road network: any of the ways that it offers them, within bounds on how they drive.

Whoever is on a lane, or reaches into it, may follow it to its end, and any lane that goes on from there; whoever is
known to follow a route, only that. Nobody turns into a neighbouring lane that it does not touch yet: who does has
taken more room, and that is for `shield.certificate.network.monitor` to judge. Each lane that one may come to is a
strip (`dynamics.road_networks.reachable.strips`, with the notation).
"""

from __future__ import annotations

import math

from dynamics.compiled import uncounted
from dynamics.highway_simulator.layout import LANE_LENGTH, LANE_LIMIT
from dynamics.road_networks.geometry.lanes import Lanes, local, place
from dynamics.road_networks.geometry.layout import ROAD
from dynamics.road_networks.reachable.continuations import SETTLED
from dynamics.road_networks.reachable.standing import ALIGNED, Subject, stand
from dynamics.road_networks.reachable.strips import (
    BACK,
    BEFORE,
    FAR,
    FRONT,
    HALF,
    HIGH,
    KEEP,
    LOW,
    NEAR,
    START,
    Conduct,
    Strip,
    Strips,
    Ways,
    add,
    curvature,
    half_of,
    keep_of,
    steepness,
    stopping_way,
)
from dynamics.state import FloatArray, IntArray, Vehicle

__all__ = ["reach", "spread"]

_WIDTH = int(Vehicle.WIDTH)
_STRAIGHT = math.cos(ALIGNED)
_STANDS = 0.5
"""Who keeps to a lane that ends and is slower than that waits there until those beside it have gone by [m/s]."""
_CREEPS, _GAIN = 3.0, 0.34
"""Who is slower than that [m/s] can steer so hard that it gains this share of what others do, along its lane."""
_TURNS, _GAIN_OVER = 16.0, 0.1
"""The same of who may come over to the lane beside."""


@uncounted
def _swap(strips: Strips, j: int, k: int) -> None:
    marks, numbers = strips.marks, strips.numbers
    for c in range(marks.shape[1]):
        marks[j, c], marks[k, c] = marks[k, c], marks[j, c]
    for c in range(numbers.shape[1]):
        numbers[j, c], numbers[k, c] = numbers[k, c], numbers[j, c]


@uncounted
def _chain(ways: Ways, strips: Strips, first: int, count: int) -> None:
    """Who is just before a lane, and in one that leads to it, comes into it from there."""
    marks, numbers = strips.marks, strips.numbers
    last = count
    for j in range(count - 1, first - 1, -1):
        if numbers[j, START] < 0:
            last -= 1
            _swap(strips, j, last)
    for j in range(last, count):
        for k in range(first, j):
            for after in ways.after[marks[k, 1]]:
                if after == marks[j, 1]:
                    marks[j, 2] = k


@uncounted
def _half_on(lanes: Lanes, conduct: Conduct, row: FloatArray, strips: Strips, j: int, lane: int) -> float:
    """Half of a body along a lane that it comes to from strip j [m]: one that is askew now may be so there."""
    askew = strips.numbers[j, HALF] - half_of(lanes, strips.marks[j, 1], row, conduct)
    return half_of(lanes, lane, row, conduct) + max(askew, 0.0)


@uncounted
def _comes_over(lanes: Lanes, ways: Ways, conduct: Conduct, row: FloatArray, strips: Strips, j: int) -> Strip:
    """The strip of the lane beside one that ends, into which one may come from it anywhere; the strip of that which
    ends is given the room for it."""
    lane, numbers = strips.marks[j, 1], strips.numbers[j]
    beside = ways.over[lane]
    x, y = place(lanes, lane, 0.0)
    s, r = local(lanes, beside, x, y)
    keep = keep_of(lanes, beside, row, conduct)
    numbers[LOW], numbers[HIGH] = min(numbers[LOW], -r - keep), max(numbers[HIGH], keep - r)
    numbers[BACK] = numbers[FAR] + lanes.rows[lane, LANE_LENGTH] + SETTLED
    low, high = min(-keep, numbers[LOW] + r), max(keep, numbers[HIGH] + r)
    near, far, start = numbers[NEAR] - s, numbers[FAR] - s, numbers[START] + s
    half = _half_on(lanes, conduct, row, strips, j, beside)
    return Strip(strips.marks[j, 0], beside, j, near, far, low, high, half, start, numbers[BACK], keep, numbers[FRONT])


@uncounted
def _goes_on(lanes: Lanes, ways: Ways, conduct: Conduct, row: FloatArray, strips: Strips, j: int, k: int) -> Strip:
    """The strip of the k-th lane after that of strip j."""
    lane, numbers = strips.marks[j, 1], strips.numbers[j]
    after, long = ways.after[lane, k], lanes.rows[lane, LANE_LENGTH]
    s, r, slack = ways.ends[lane, k, 0], ways.ends[lane, k, 1], ways.ends[lane, k, 2]
    near, far, back = numbers[NEAR] + long - s - slack, numbers[FAR] + long - s + slack, numbers[BACK]
    keep = keep_of(lanes, after, row, conduct)
    low, high = -keep, keep
    if numbers[FAR] + long < back and ways.over[lane] < 0:
        # Who is beside the middle of its lane is as far beside that of the next; its body is what it is now.
        less = numbers[KEEP] - keep
        if strips.marks[j, 2] == -1:
            less = min(less, 0.0)
        low, high = min(low, numbers[LOW] + less), max(high, numbers[HIGH] - less)
    if slack > 0:
        # Who has to come over from beside a lane does so in the course of it.
        low, high = low + min(r, 0.0) - slack, high + max(r, 0.0) + slack
        back = numbers[FAR] + long + SETTLED
    half = _half_on(lanes, conduct, row, strips, j, after)
    # Who is about to come into it from any lane is on it from there on.
    start = ways.entries[after, 0] - BEFORE
    return Strip(strips.marks[j, 0], after, j, near, far, low, high, half, start, back, keep, numbers[FRONT])


@uncounted
def _pace(lanes: Lanes, conduct: Conduct, lane: int, off: float, drive: FloatArray) -> None:
    """What a lane, so far `off` the middle of which one may be [m], adds to a row of `drive`, see `spread`."""
    limit, share = lanes.rows[lane, LANE_LIMIT], min(curvature(lanes, lane) * off, 0.5)
    drive[0] = max(drive[0], limit if limit < math.inf else conduct.top)
    drive[1], drive[2] = min(drive[1], _STRAIGHT / (1 + share)), max(drive[2], 1 / (1 - share))
    slope = steepness(lanes, lane)
    drive[1] = min(drive[1], _STRAIGHT / math.sqrt(1 + slope * slope))


@uncounted
def _lead_on(
    lanes: Lanes,
    ways: Ways,
    conduct: Conduct,
    subject: Subject,
    strips: Strips,
    drive: FloatArray,
    first: int,
    count: int,
    j: int,
) -> int:
    """The strips that strip j leads to; how many there are then. Whoever has a route keeps to it, until it is over or
    does not go on from here."""
    lane, row, route, numbers = strips.marks[j, 1], subject.row, subject.route, strips.numbers[j]
    stop = stopping_way(row, conduct)
    keeps = strips.marks[j, 2] == -1 and max(numbers[HIGH], -numbers[LOW]) <= numbers[KEEP]
    if ways.over[lane] >= 0 and row[3] <= _STANDS and keeps:
        return count
    if ways.over[lane] >= 0:
        drive[3], drive[4] = _TURNS, _GAIN_OVER
        count = add(strips, first, count, _comes_over(lanes, ways, conduct, row, strips, j), stop)
    known = subject.limited and route[lanes.ids[lane, ROAD]] < 2
    for anywhere in range(2):
        some = False
        for k in range(ways.after.shape[1]):
            after = ways.after[lane, k]
            if after >= 0 and not (known and anywhere == 0 and route[lanes.ids[after, ROAD]] == 0):
                some = True
                count = add(strips, first, count, _goes_on(lanes, ways, conduct, row, strips, j, k), stop)
        if some or not known:
            break
    return count


@uncounted
def spread(
    lanes: Lanes,
    ways: Ways,
    conduct: Conduct,
    rows: FloatArray,
    own: IntArray,
    routes: IntArray,
    strips: Strips,
    drive: FloatArray,
) -> int:
    """All strips of all vehicles.

    Parameters
    ----------
    rows : of the vehicles, (m, 7). own : the lane that each is on, (m,).
    routes : for each road, 1 where it is on a vehicle's route, 2 where it is the last of it, (m, roads); all 0 of whom
        no route is known.
    strips : written.
    drive : speed that it accelerates to [m/s], the least and the greatest metres of s in a metre driven, and the speed
        below which it may gain only a part of that [m/s], and which, (m, 5); written.

    Returns
    -------
    How many there are; more than there is room for if there was not enough.
    """
    count, room = 0, strips.marks.shape[0]
    marks, numbers = strips.marks, strips.numbers
    for i in range(rows.shape[0]):
        first, routed = count, False
        for k in range(routes.shape[1]):
            routed = routed or routes[i, k] > 0
        subject = Subject(i, rows[i], own[i], routes[i], routed)
        count = stand(lanes, ways, conduct, subject, strips, first)
        _chain(ways, strips, first, min(count, room))
        drive[i, 0], drive[i, 1], drive[i, 2], drive[i, 3], drive[i, 4] = 0.0, _STRAIGHT, 1.0, _CREEPS, _GAIN
        j = first
        while j < min(count, room):
            off = max(-numbers[j, LOW], numbers[j, HIGH]) - 0.5 * rows[i, _WIDTH]
            _pace(lanes, conduct, marks[j, 1], off, drive[i])
            count = _lead_on(lanes, ways, conduct, subject, strips, drive[i], first, count, j)
            j += 1
        if count > room:
            return count
    return count


@uncounted
def reach(
    conduct: Conduct, rows: FloatArray, drive: FloatArray, dt: float, least: FloatArray, most: FloatArray
) -> None:
    """How far each vehicle may have got by each frame, in metres of s: `least` and `most`, (m, K), from now on."""
    for i in range(rows.shape[0]):
        slow, fast, back, ahead = rows[i, 3], max(rows[i, 3], 0.0), 0.0, 0.0
        cap = max(drive[i, 0], fast)
        for k in range(least.shape[1]):
            least[i, k], most[i, k] = min(back * drive[i, 1], back * drive[i, 2]), ahead * drive[i, 2]
            back += slow * dt * (drive[i, 4] if 0.0 < slow < drive[i, 3] else 1.0)
            ahead += fast * dt
            slow = max(slow - conduct.braking * dt, 0.0) if slow > 0 else min(slow + conduct.braking * dt, 0.0)
            fast = min(fast + conduct.acceleration * dt, cap)
