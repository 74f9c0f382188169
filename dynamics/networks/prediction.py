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

from dynamics.compiled import inlined, uncounted
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
    "KEEP",
    "LOW",
    "NEAR",
    "SEVERAL",
    "START",
    "STRIP",
    "Conduct",
    "Strips",
    "Ways",
    "reach",
    "spread",
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

_LENGTH, _WIDTH = int(Vehicle.LENGTH), int(Vehicle.WIDTH)
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
_ROUNDING = 1e-6
_DRIFT = 6.0
"""How far out of the middle of an arc one drifts, times its radius [m^2]."""
_CREEPS, _GAIN = 3.0, 0.34
"""Who is slower than that [m/s] can steer so hard that it gains this share of what others do, along its lane."""


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


class _Strip(NamedTuple):
    """One of them."""

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


class _Subject(NamedTuple):
    """A vehicle: its number, its row (7,), the lane that it is on, and which roads its route has, (roads,), where it is
    `limited` to them."""

    number: int
    row: FloatArray
    own: int
    route: IntArray
    limited: bool


class _Pose(NamedTuple):
    """A body on a lane: s and r [m], the angle between them [rad], how far it reaches to either side and how far once
    it keeps to the middle [m], and whether it is where one may be in that lane, or about to come into it."""

    s: float
    r: float
    angle: float
    across: float
    keep: float
    within: bool


@uncounted
def _curvature(lanes: Lanes, lane: int) -> float:
    return 1 / lanes.rows[lane, RADIUS] if lanes.ids[lane, SHAPE] == CIRCULAR else 0.0


@uncounted
def _bulge(lanes: Lanes, lane: int, row: FloatArray) -> float:
    """How much further the corners of a body reach on an arc [m]."""
    return _curvature(lanes, lane) * row[_LENGTH] * row[_LENGTH] / 8


@uncounted
def _keep(lanes: Lanes, lane: int, row: FloatArray, conduct: Conduct) -> float:
    """How far a body reaches to either side that keeps to the middle of a lane; on an arc it drifts, too [m]."""
    return 0.5 * row[_WIDTH] + conduct.sway + _bulge(lanes, lane, row) + _curvature(lanes, lane) * _DRIFT


@uncounted
def _pose(lanes: Lanes, ways: Ways, conduct: Conduct, row: FloatArray, lane: int) -> _Pose:
    s, r = local(lanes, lane, row[0], row[1])
    long, keep = lanes.rows[lane, LANE_LENGTH], _keep(lanes, lane, row, conduct)
    angle = wrap_to_pi(row[2] - heading_at(lanes, lane, min(max(s, 0.0), long)))
    across = 0.5 * (row[_LENGTH] * abs(math.sin(angle)) + row[_WIDTH] * abs(math.cos(angle)))
    across += _bulge(lanes, lane, row)
    return _Pose(s, r, angle, across, keep, ways.entries[lane, 0] - _BEFORE <= s <= long)


@uncounted
def _add(strips: Strips, first: int, count: int, strip: _Strip) -> int:
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


@inlined
def _off_route(lanes: Lanes, subject: _Subject, lane: int) -> bool:
    return subject.limited and subject.route[lanes.ids[lane, ROAD]] == 0


@uncounted
def _stand(subject: _Subject, lane: int, at: _Pose, low: float, high: float, back: float) -> _Strip:
    """The strip of a lane that a vehicle is on."""
    row = subject.row
    cos, sin = abs(math.cos(at.angle)), abs(math.sin(at.angle))
    half = max(0.5 * (row[_LENGTH] * cos + row[_WIDTH] * sin), 0.5 * (row[_LENGTH] + row[_WIDTH] * _ASKEW))
    return _Strip(subject.number, lane, -1, -at.s, -at.s, low, high, half, min(at.s, 0.0), back, at.keep)


@uncounted
def _kept(lanes: Lanes, ways: Ways, conduct: Conduct, subject: _Subject, strips: Strips, first: int) -> int:
    """The lanes to which a vehicle keeps: of its route, or any; how many strips there are then. Who keeps to none but
    such as it has not come to is still between lanes."""
    count, some = first, False
    for lane in range(lanes.rows.shape[0]):
        if _off_route(lanes, subject, lane):
            continue
        at = _pose(lanes, ways, conduct, subject.row, lane)
        if at.within and abs(at.angle) <= _ALIGNED and abs(at.r) + at.across <= at.keep:
            count = _add(strips, first, count, _stand(subject, lane, at, -at.keep, at.keep, 0.0))
            some = some or at.s >= 0.0
    return count if some else first


@uncounted
def _entered(lanes: Lanes, ways: Ways, conduct: Conduct, subject: _Subject, strips: Strips, first: int) -> int:
    """The lanes into which a vehicle is coming from beside them, and with any such the one that it is on; likewise."""
    count, some = first, False
    for lane in range(lanes.rows.shape[0]):
        if _off_route(lanes, subject, lane):
            continue
        at = _pose(lanes, ways, conduct, subject.row, lane)
        low, high = at.r - at.across, at.r + at.across
        if lane == subject.own:
            low, high = min(low, -at.keep), max(high, at.keep)
            count = _add(strips, first, count, _stand(subject, lane, at, low, high, SETTLED))
            continue
        least, most = -at.keep + ways.entries[lane, 1], at.keep + ways.entries[lane, 2]
        if at.within and abs(at.angle) <= _TURNING and low >= least and high <= most:
            low, high = max(least, min(low - _SWEEP, -at.keep)), min(most, max(high + _SWEEP, at.keep))
            count = _add(strips, first, count, _stand(subject, lane, at, low, high, SETTLED))
            some = True
    return count if some else first


@uncounted
def _touched(lanes: Lanes, ways: Ways, conduct: Conduct, subject: _Subject, strips: Strips, first: int) -> int:
    """The lanes that a vehicle touches, which is between them; likewise."""
    count = first
    for lane in range(lanes.rows.shape[0]):
        at = _pose(lanes, ways, conduct, subject.row, lane)
        if lane != subject.own:
            if lanes.ids[lane, ROAD] == lanes.ids[subject.own, ROAD]:
                if abs(at.r) - at.across >= lanes.rows[lane, LANE_WIDTH] / 2 - conduct.lean:
                    continue
            elif not (abs(at.r) <= _OVERLAY and at.within and abs(at.angle) <= _ALIGNED):
                continue
        low, high = min(at.r - at.across, -at.keep), max(at.r + at.across, at.keep)
        count = _add(strips, first, count, _stand(subject, lane, at, low, high, SETTLED))
    return count


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
def _comes_over(lanes: Lanes, ways: Ways, conduct: Conduct, row: FloatArray, strips: Strips, j: int) -> _Strip:
    """The strip of the lane beside one that ends, into which one may come from it anywhere."""
    lane, numbers = strips.marks[j, 1], strips.numbers[j]
    beside = ways.over[lane]
    x, y = place(lanes, lane, 0.0)
    s, r = local(lanes, beside, x, y)
    keep = _keep(lanes, beside, row, conduct)
    low, high = min(-keep, numbers[LOW] + r), max(keep, numbers[HIGH] + r)
    back = numbers[FAR] + lanes.rows[lane, LANE_LENGTH]
    near, far, start = numbers[NEAR] - s, numbers[FAR] - s, numbers[START] + s
    return _Strip(strips.marks[j, 0], beside, j, near, far, low, high, numbers[HALF], start, back, keep)


@uncounted
def _goes_on(lanes: Lanes, ways: Ways, conduct: Conduct, row: FloatArray, strips: Strips, j: int, k: int) -> _Strip:
    """The strip of the k-th lane after that of strip j."""
    lane, numbers = strips.marks[j, 1], strips.numbers[j]
    after, long = ways.after[lane, k], lanes.rows[lane, LANE_LENGTH]
    s, r, slack = ways.ends[lane, k, 0], ways.ends[lane, k, 1], ways.ends[lane, k, 2]
    near, far, back = numbers[NEAR] + long - s - slack, numbers[FAR] + long - s + slack, numbers[BACK]
    keep = _keep(lanes, after, row, conduct)
    low, high = -keep, keep
    if numbers[FAR] + long < back:
        low, high = min(low, numbers[LOW]), max(high, numbers[HIGH])
    if slack > 0:
        # Who has to come over from beside a lane does so in the course of it.
        low, high = low + min(r, 0.0) - slack, high + max(r, 0.0) + slack
        back = numbers[FAR] + long + SETTLED
    return _Strip(strips.marks[j, 0], after, j, near, far, low, high, numbers[HALF], s - _BEFORE, back, keep)


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
    drive : speed that it accelerates to [m/s], and the least and the greatest metres of s in a metre driven, (m, 3);
        written.

    Returns
    -------
    How many there are; more than there is room for if there was not enough.
    """
    count, room = 0, strips.marks.shape[0]
    marks, numbers = strips.marks, strips.numbers
    for i in range(rows.shape[0]):
        first, row, route, routed = count, rows[i], routes[i], False
        for k in range(routes.shape[1]):
            routed = routed or route[k] > 0
        for anywhere in range(0 if routed else 1, 2):
            subject = _Subject(i, row, own[i], route, anywhere == 0)
            if count == first:
                count = _kept(lanes, ways, conduct, subject, strips, first)
            if count == first:
                count = _entered(lanes, ways, conduct, subject, strips, first)
        if count == first:
            count = _touched(lanes, ways, conduct, _Subject(i, row, own[i], route, False), strips, first)
        _chain(ways, strips, first, min(count, room))
        j, straight = first, math.cos(_ALIGNED)
        drive[i, 0], drive[i, 1], drive[i, 2] = 0.0, straight, 1.0
        while j < min(count, room):
            lane = marks[j, 1]
            limit, off = lanes.rows[lane, LANE_LIMIT], max(-numbers[j, LOW], numbers[j, HIGH]) - 0.5 * row[_WIDTH]
            drive[i, 0] = max(drive[i, 0], limit if limit < math.inf else conduct.top)
            share = min(_curvature(lanes, lane) * off, 0.5)
            drive[i, 1], drive[i, 2] = min(drive[i, 1], straight / (1 + share)), max(drive[i, 2], 1 / (1 - share))
            if lanes.ids[lane, SHAPE] == SINE:
                slope = abs(lanes.rows[lane, AMPLITUDE] * lanes.rows[lane, PULSATION])
                drive[i, 1] = min(drive[i, 1], straight / math.sqrt(1 + slope * slope))
            if ways.over[lane] >= 0 and row[3] > _STANDS:
                count = _add(strips, first, count, _comes_over(lanes, ways, conduct, row, strips, j))
            waits = ways.over[lane] >= 0 and row[3] <= _STANDS
            known = routed and route[lanes.ids[lane, ROAD]] < 2
            for limited in range(2):
                some = False
                for k in range(ways.after.shape[1]):
                    after = ways.after[lane, k]
                    if after >= 0 and not waits and not (known and limited == 0 and route[lanes.ids[after, ROAD]] == 0):
                        some = True
                        count = _add(strips, first, count, _goes_on(lanes, ways, conduct, row, strips, j, k))
                if some or not known:
                    break
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
            back += slow * dt * (_GAIN if 0.0 < slow < _CREEPS else 1.0)
            ahead += fast * dt
            slow = max(slow - conduct.braking * dt, 0.0) if slow > 0 else min(slow + conduct.braking * dt, 0.0)
            fast = min(fast + conduct.acceleration * dt, cap)
