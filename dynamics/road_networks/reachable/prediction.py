"""Reachable places of other vehicles on a road network: all lanes that it offers them, within bounds on how they drive.

A vehicle that is on a lane, or reaches into it, may follow it to its end, and then any lane that continues it. A
vehicle with a known route follows only the route. No vehicle turns into a neighbouring lane that it does not touch yet.
A vehicle that does so has taken more room, which `shield.certificate.network.monitor` checks. Each lane that a vehicle
may reach is a strip (`dynamics.road_networks.reachable.strips`, with the notation).
"""

from __future__ import annotations

import math

from dynamics.compiled import kernel_no_refcount
from dynamics.highway_simulator.layout import LANE_LENGTH, LANE_LIMIT
from dynamics.road_networks.geometry.lanes import NetworkLanes, local, place
from dynamics.road_networks.geometry.layout import ROAD
from dynamics.road_networks.reachable.continuations import RECENTRED_DISTANCE, TURN_IN_DISTANCE
from dynamics.road_networks.reachable.present_lanes import ALIGNED, NetworkVehicle, add_present_strips
from dynamics.road_networks.reachable.strips import (
    BODY_HALF,
    CENTRED_FROM,
    CENTRED_HALF,
    FAR,
    FRONT,
    HIGH,
    LOW,
    NEAR,
    START,
    DrivingBounds,
    LaneContinuations,
    Strip,
    Strips,
    add,
    body_half,
    centred_half,
    curvature,
    steepness,
    stopping_distance_bound,
)
from dynamics.state import FloatArray, IntArray, Vehicle

__all__ = ["add_all_strips", "distance_bounds"]

_WIDTH = int(Vehicle.WIDTH)
_STRAIGHT = math.cos(ALIGNED)
_WAITING_SPEED = 0.5
"""A vehicle slower than this that keeps to a lane that ends waits there until the vehicles beside it have passed
[m/s]."""
_SLOW_SPEED, _GAIN = 3.0, 0.34
"""Below the speed `_SLOW_SPEED` [m/s] a vehicle can steer so hard that only the share `_GAIN` of the distance driven is
along its lane."""
_SLOW_SPEED_BESIDE, _GAIN_OVER = 16.0, 0.1
"""The same for a vehicle that may change to the neighbouring lane."""


@kernel_no_refcount
def _swap(strips: Strips, j: int, k: int) -> None:
    """Exchange two strips."""
    marks, numbers = strips.marks, strips.numbers
    for c in range(marks.shape[1]):
        marks[j, c], marks[k, c] = marks[k, c], marks[j, c]
    for c in range(numbers.shape[1]):
        numbers[j, c], numbers[k, c] = numbers[k, c], numbers[j, c]


@kernel_no_refcount
def _link_parents(ways: LaneContinuations, strips: Strips, first: int, count: int) -> None:
    """Link the strips of a vehicle that is just before a lane: where it is also on a lane that leads there, that is the
    parent. Such strips are moved to the end."""
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


@kernel_no_refcount
def _half_on(lanes: NetworkLanes, bounds: DrivingBounds, row: FloatArray, strips: Strips, j: int, lane: int) -> float:
    """Half of a body's length along a lane that it reaches from strip j [m]. A body that is at an angle to its lane now
    may still be so there."""
    askew = strips.numbers[j, BODY_HALF] - body_half(lanes, strips.marks[j, 1], row, bounds)
    return body_half(lanes, lane, row, bounds) + max(askew, 0.0)


@kernel_no_refcount
def _neighbour_strip(
    lanes: NetworkLanes, ways: LaneContinuations, bounds: DrivingBounds, row: FloatArray, strips: Strips, j: int
) -> Strip:
    """The strip of the lane beside one that ends, strip j. A vehicle may change to it at any place, and strip j is
    widened by the room for that."""
    lane, numbers = strips.marks[j, 1], strips.numbers[j]
    beside = ways.over[lane]
    x, y = place(lanes, lane, 0.0)
    s, r = local(lanes, beside, x, y)
    keep = centred_half(lanes, beside, row, bounds)
    numbers[LOW], numbers[HIGH] = min(numbers[LOW], -r - keep), max(numbers[HIGH], keep - r)
    numbers[CENTRED_FROM] = numbers[FAR] + lanes.rows[lane, LANE_LENGTH] + RECENTRED_DISTANCE
    low, high = min(-keep, numbers[LOW] + r), max(keep, numbers[HIGH] + r)
    near, far, start = numbers[NEAR] - s, numbers[FAR] - s, numbers[START] + s
    half = _half_on(lanes, bounds, row, strips, j, beside)
    return Strip(
        strips.marks[j, 0], beside, j, near, far, low, high, half, start, numbers[CENTRED_FROM], keep, numbers[FRONT]
    )


@kernel_no_refcount
def _following_strip(
    lanes: NetworkLanes,
    ways: LaneContinuations,
    bounds: DrivingBounds,
    row: FloatArray,
    strips: Strips,
    j: int,
    k: int,
) -> Strip:
    """The strip of the k-th lane after that of strip j."""
    lane, numbers = strips.marks[j, 1], strips.numbers[j]
    after, long = ways.after[lane, k], lanes.rows[lane, LANE_LENGTH]
    s, r, slack = ways.ends[lane, k, 0], ways.ends[lane, k, 1], ways.ends[lane, k, 2]
    near, far, back = numbers[NEAR] + long - s - slack, numbers[FAR] + long - s + slack, numbers[CENTRED_FROM]
    keep = centred_half(lanes, after, row, bounds)
    low, high = -keep, keep
    if numbers[FAR] + long < back and ways.over[lane] < 0:
        # A vehicle beside the centre of its lane is as far beside the centre of the next one. Its body keeps its size.
        less = numbers[CENTRED_HALF] - keep
        if strips.marks[j, 2] == -1:
            less = min(less, 0.0)
        low, high = min(low, numbers[LOW] + less), max(high, numbers[HIGH] - less)
    if slack > 0:
        # A vehicle that is beside a lane reaches its centre while it drives along it.
        low, high = low + min(r, 0.0) - slack, high + max(r, 0.0) + slack
        back = numbers[FAR] + long + RECENTRED_DISTANCE
    half = _half_on(lanes, bounds, row, strips, j, after)
    # A vehicle that is about to enter the lane, from any lane, counts as on it from there on.
    start = ways.entries[after, 0] - TURN_IN_DISTANCE
    return Strip(strips.marks[j, 0], after, j, near, far, low, high, half, start, back, keep, numbers[FRONT])


@kernel_no_refcount
def _update_distance_bounds(
    lanes: NetworkLanes, bounds: DrivingBounds, lane: int, off: float, drive: FloatArray
) -> None:
    """Update a row of `drive` (see `add_all_strips`) for a lane on which the vehicle may be `off` beside the centre
    [m]."""
    limit, share = lanes.rows[lane, LANE_LIMIT], min(curvature(lanes, lane) * off, 0.5)
    drive[0] = max(drive[0], limit if limit < math.inf else bounds.top)
    drive[1], drive[2] = min(drive[1], _STRAIGHT / (1 + share)), max(drive[2], 1 / (1 - share))
    slope = steepness(lanes, lane)
    drive[1] = min(drive[1], _STRAIGHT / math.sqrt(1 + slope * slope))


@kernel_no_refcount
def _add_next_strips(
    lanes: NetworkLanes,
    ways: LaneContinuations,
    bounds: DrivingBounds,
    subject: NetworkVehicle,
    strips: Strips,
    count: int,
    j: int,
) -> int:
    """Add the strips that strip j leads to, after the first `count`. A vehicle with a route follows it, until the route
    ends or does not continue from here.

    Returns
    -------
    The number of strips.
    """
    lane, row, route, numbers = strips.marks[j, 1], subject.row, subject.route, strips.numbers[j]
    stop, first, drive = stopping_distance_bound(row, bounds), subject.first, subject.drive
    keeps = strips.marks[j, 2] == -1 and max(numbers[HIGH], -numbers[LOW]) <= numbers[CENTRED_HALF]
    if ways.over[lane] >= 0 and row[3] <= _WAITING_SPEED and keeps:
        return count
    if ways.over[lane] >= 0:
        drive[3], drive[4] = _SLOW_SPEED_BESIDE, _GAIN_OVER
        count = add(strips, first, count, _neighbour_strip(lanes, ways, bounds, row, strips, j), stop)
    known = subject.limited and route[lanes.ids[lane, ROAD]] < 2
    for anywhere in range(2):
        some = False
        for k in range(ways.after.shape[1]):
            after = ways.after[lane, k]
            if after >= 0 and not (known and anywhere == 0 and route[lanes.ids[after, ROAD]] == 0):
                some = True
                count = add(strips, first, count, _following_strip(lanes, ways, bounds, row, strips, j, k), stop)
        if some or not known:
            break
    return count


@kernel_no_refcount
def add_all_strips(
    lanes: NetworkLanes,
    ways: LaneContinuations,
    bounds: DrivingBounds,
    rows: FloatArray,
    own: IntArray,
    routes: IntArray,
    strips: Strips,
    drive: FloatArray,
) -> int:
    """All strips of all vehicles.

    Parameters
    ----------
    rows : vehicle rows, (m, 7). own : the lane that each vehicle is on, (m,).
    routes : for each road, 1 if it is on a vehicle's route, 2 if it is the last road of it, (m, roads); all 0 for a
        vehicle without a known route.
    strips : written.
    drive : (m, 5), written. Speed that the vehicle accelerates to [m/s]; least and greatest metres of s in a metre
        driven; the speed below which only a share of the distance driven may be along the lane [m/s]; and that share.

    Returns
    -------
    The number of strips; more than the buffer holds if it was too small.
    """
    count, room = 0, strips.marks.shape[0]
    marks, numbers = strips.marks, strips.numbers
    for i in range(rows.shape[0]):
        first, routed = count, False
        for k in range(routes.shape[1]):
            routed = routed or routes[i, k] > 0
        subject = NetworkVehicle(i, rows[i], own[i], routes[i], routed, drive[i], first)
        count = add_present_strips(lanes, ways, bounds, subject, strips)
        _link_parents(ways, strips, first, min(count, room))
        drive[i, 0], drive[i, 1], drive[i, 2], drive[i, 3], drive[i, 4] = 0.0, _STRAIGHT, 1.0, _SLOW_SPEED, _GAIN
        j = first
        while j < min(count, room):
            off = max(-numbers[j, LOW], numbers[j, HIGH]) - 0.5 * rows[i, _WIDTH]
            _update_distance_bounds(lanes, bounds, marks[j, 1], off, drive[i])
            count = _add_next_strips(lanes, ways, bounds, subject, strips, count, j)
            j += 1
        if count > room:
            return count
    return count


@kernel_no_refcount
def distance_bounds(
    bounds: DrivingBounds, rows: FloatArray, drive: FloatArray, dt: float, least: FloatArray, most: FloatArray
) -> None:
    """Least and greatest distance that each vehicle may have driven by each frame, in metres of s: `least` and `most`,
    (m, K), written."""
    for i in range(rows.shape[0]):
        slow, fast, back, ahead = rows[i, 3], max(rows[i, 3], 0.0), 0.0, 0.0
        cap = max(drive[i, 0], fast)
        for k in range(least.shape[1]):
            least[i, k], most[i, k] = min(back * drive[i, 1], back * drive[i, 2]), ahead * drive[i, 2]
            back += slow * dt * (drive[i, 4] if 0.0 < slow < drive[i, 3] else 1.0)
            ahead += fast * dt
            slow = max(slow - bounds.braking * dt, 0.0) if slow > 0 else min(slow + bounds.braking * dt, 0.0)
            fast = min(fast + bounds.acceleration * dt, cap)
