"""Kernels of the occupancy: one pass over the vehicles, and one over vehicles and frames.

`dynamics.traffic.occupancy` defines the quantities and gives their sources.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.state import FloatArray, IntArray, Vehicle
from dynamics.traffic.tables import Motion, ReachableBodies, VehicleBodies

__all__ = [
    "LaneMarkings",
    "apart",
    "front_of",
    "fronts",
    "lap_distance",
    "least_next_position",
    "least_rest_positions",
    "rear_of",
    "rears",
    "straight_overshoot",
    "touched_lanes",
    "update_turning_allowances",
]

_SPEED, _LENGTH, _WIDTH, _CRASHED = int(Vehicle.SPEED), int(Vehicle.LENGTH), int(Vehicle.WIDTH), int(Vehicle.CRASHED)
_ENDLESS = 1e6
"""Distance covered by a vehicle that is assumed never to stop [m]."""


class LaneMarkings(NamedTuple):
    """Lanes of a road, and tolerances at their markings.

    Attributes
    ----------
    centers : (lanes,) [m]. width : of each lane [m].
    marking_tolerance : how far a body may reach over a marking before it counts as in the next lane too [m].
    lateral_deviation : greatest lateral deviation of a body that keeps to the centre of its lane [m].
    dt : duration of a frame [s].
    """

    centers: FloatArray
    width: float
    marking_tolerance: float
    lateral_deviation: float
    dt: float


@kernel_inline
def straight_overshoot(curvature: float, length: float, distance: float) -> float:
    """How far a body leaves its bend within a frame of straight motion [m]. highway-env tests for crashes with such
    motion.

    The nose of a body of length L that drives d on the tangent of a path of curvature k deviates by k (L/2 + d)^2 / 2.
    The part k L^2 / 8 is the chord of the body, which `dynamics.roads.footprint` contains.
    """
    return 0.5 * curvature * distance * (length + distance)


@kernel_no_refcount
def touched_lanes(
    others: FloatArray, states: FloatArray, growth: FloatArray, lanes: LaneMarkings, bodies: ReachableBodies
) -> None:
    """Fill in `lane`, `first`, `last`, `low`, `high` and `reach` of `bodies`; NaN for a vehicle with NaN in its row.

    Parameters
    ----------
    others : vehicle rows (m, 7). states : road states (m, 4).
    growth : how much a bend adds to each body along and across, (m, 2) [m]; no rows on a straight road.
    """
    centers, count = lanes.centers, lanes.centers.shape[0]
    # Before the loop, since it is slow to read an array from a tuple inside it.
    lane, starts, ends, lows, highs, reach = (
        bodies.lane,
        bodies.first,
        bodies.last,
        bodies.low,
        bodies.high,
        bodies.reach,
    )
    shape = (np.nan, np.nan, np.nan)
    for i in range(states.shape[0]):
        s, r, psi, v = states[i, 0], states[i, 1], states[i, 2], states[i, 3]
        length, width = others[i, _LENGTH], others[i, _WIDTH]
        if not math.isfinite(s + r + psi + v + length + width):
            lane[i], starts[i], ends[i] = 0, 0, count - 1
            lows[i], highs[i], reach[i] = np.nan, np.nan, np.nan
            continue
        sin = math.sin(psi)
        half = 0.5 * (length * abs(sin) + width * abs(math.cos(psi)))
        # highway-env tests for crashes with the positions that constant velocity along the heading gives after a frame.
        drift = v * sin * lanes.dt
        low, high = r - half + min(drift, 0.0), r + half + max(drift, 0.0)
        here = int(min(max(np.rint((r - centers[0]) / lanes.width), 0), count - 1))
        side, core = 0.5 * lanes.width + lanes.marking_tolerance, 0.5 * width + lanes.lateral_deviation
        first, last = count, -1
        for j in range(count):
            if (
                high > centers[j] - side + 2 * lanes.marking_tolerance
                and low < centers[j] + side - 2 * lanes.marking_tolerance
            ):
                first, last = min(first, j), max(last, j)
        lane[i], starts[i], ends[i] = here, first, last
        if first <= last:
            # Up to the marking; or, for a body near the centre of the lane or on its way there, up to its deviation
            # `lateral_deviation`.
            least, most = centers[first] - side, centers[last] + side
            if low >= centers[first] - core:
                least = centers[first] - core
            if high <= centers[last] + core:
                most = centers[last] + core
            low, high = min(low, least), max(high, most)
        along, across = (growth[i, 0], growth[i, 1]) if growth.shape[0] > 0 else (0.0, 0.0)
        lows[i], highs[i] = low - across, high + across
        if length != shape[0] or width != shape[1]:  # most vehicles have the same size
            shape = (length, width, 0.5 * math.hypot(length, width))
        reach[i] = shape[2] + along


@kernel_inline
def lap_distance(distance: float, lap: float) -> float:
    """The distance the shorter way round a closed road of length `lap`, unchanged on an open one (0) [m]."""
    if lap > 0:
        distance -= lap * np.rint(distance / lap)
    return distance


@kernel_no_refcount
def update_turning_allowances(
    states0: FloatArray,
    bodies0: ReachableBodies,
    states: FloatArray,
    stretch: FloatArray,
    motion: Motion,
    lap: float,
    bodies: ReachableBodies,
) -> None:
    """Fill in `budget`, `action` and `recent` of `bodies` from the frame before: the allowances left, plus their
    recovery, less the distance lost by turning.

    Parameters
    ----------
    states0, bodies0 : of the frame before. states : road states of this frame, (m, 4).
    stretch : see `rear_of`. lap : length of a closed road, 0 of an open one [m].
    """
    left, left_action, before = bodies0.budget, bodies0.action, bodies0.recent
    budgets, actions, recent, swings = bodies.budget, bodies.action, bodies.recent, bodies.swing
    for i in range(states.shape[0]):
        v, swing, lost = states0[i, 3], swings[i], 0.0
        if v >= motion.slow:
            ds = lap_distance(states[i, 0] - states0[i, 0], lap)
            # In metres driven, as are the bounds; `stretch` converts metres of s.
            lost = max(v * motion.dt - (ds / stretch[0, i] if stretch.shape[1] > 0 else ds), 0.0)
        budget, action = motion.loss_back * motion.dt, motion.action_back * motion.dt
        budgets[i] = min(max(left[i], 0.0) + budget, swing * motion.loss) - lost
        actions[i] = min(max(left_action[i], 0.0) + action, swing * motion.action) - v * lost
        within = v * lost
        recent[i, 0] = within
        for k in range(recent.shape[1] - 1):
            within += before[i, k]
            recent[i, k + 1] = before[i, k]
        if within > swing * motion.action_in_one_second:
            actions[i] = min(actions[i], swing * motion.action_in_one_second - within)


@kernel_inline
def _lost(budget: float, action: float, slow: float, time: float, motion: Motion) -> float:
    """Greatest distance that a vehicle can have lost by turning after `time` [s], at a speed of at least `slow` [m/s],
    [m]."""
    budget = max(budget, 0.0) + motion.loss_back * time
    action = max(action, 0.0) + motion.action_back * time
    return min(budget, action / max(slow, motion.slow))


@kernel_inline
def apart(first: IntArray, last: IntArray, low: FloatArray, high: FloatArray, i: int, j: int) -> bool:
    """Whether vehicles i and j are in different lanes, by arrays of `ReachableBodies` (m,). The arrays are
    parameters, since it is slow to read them from a tuple in a loop."""
    if first[i] > last[i] or first[j] > last[j]:
        return low[j] >= high[i] or high[j] <= low[i]
    # The bands `low` to `high` of neighbouring lanes overlap by `marking_tolerance`.
    return first[j] > last[i] or last[j] < first[i]


@kernel_inline
def _rate(brakes: FloatArray, i: int, k: int, motion: Motion) -> float:
    """Hardest braking of vehicle i at the coming frame k [m/s^2]."""
    return brakes[i, k] if k < brakes.shape[1] else motion.braking


@kernel_no_refcount
def _braking_way(i: int, v: float, wrecked: bool, brakes: FloatArray, motion: Motion) -> tuple[float, float]:
    """Least distance that a vehicle covers until it is slower than `Motion.slow`, braking from now on [m], and the time
    that it takes [s]."""
    way, time, least = 0.0, 0.0, min(v, 0.0 if wrecked else motion.min_speed)
    speed, k = v, 0
    while True:
        slow = max(speed, least)
        if not slow >= motion.slow:
            return way, time
        if least >= motion.slow:
            return _ENDLESS, 0.0  # it never brakes below `min_speed`
        way, time, rate = way + slow * motion.dt, time + motion.dt, _rate(brakes, i, k, motion)
        if wrecked:
            rate = max(rate, speed)  # highway-env: a crashed vehicle brakes at -1 * speed per second
        speed, k = speed - rate * motion.dt, k + 1


@kernel_no_refcount
def least_rest_positions(
    others: FloatArray,
    states: FloatArray,
    stretch: FloatArray,
    motion: Motion,
    order: IntArray,
    bodies: ReachableBodies,
) -> None:
    """Fill in `floor` of `bodies`: the least s at which a vehicle's centre comes to rest. It is less if the vehicle may
    reverse behind a vehicle in its lanes. Otherwise a reversing vehicle comes to rest within `motion.runout`."""
    m, brakes, floor = states.shape[0], bodies.brakes, bodies.floor
    first, last, low, high = bodies.first, bodies.last, bodies.low, bodies.high
    for n in range(m):
        i = order[n]
        v, wrecked = states[i, 3], others[i, _CRASHED] > 0
        way, time = _braking_way(i, v, wrecked, brakes, motion)
        way = max(way - _lost(bodies.budget[i], bodies.action[i], 0.0, time, motion), 0.0) + min(v, 0.0) * motion.runout
        if stretch.shape[1] > 0:
            way = min(way * stretch[0, i], way * stretch[1, i])
        least = states[i, 0] + way
        if motion.reversing > 0 and not wrecked:
            for k in range(n):
                j = order[k]
                slow = states[j, 3] < motion.queue_speed
                if slow and states[j, 0] > states[i, 0] and not apart(first, last, low, high, i, j):
                    least = min(least, floor[j] - motion.queue)
        floor[i] = least


@kernel_inline
def rear_of(j: int, vehicles: VehicleBodies, stretch: FloatArray, motion: Motion, hold: int, out: FloatArray) -> None:
    """Least s of the body of vehicle `j` after each frame, `out` (frames,) [m], written.

    Parameters
    ----------
    stretch : least and greatest metres of s in a metre driven, (2, m); no columns on a straight road.
    hold : number of frames at constant speed that are expected before the worst case starts. If above 0, the result is
        a forecast and not a bound.
    """
    others, states, bodies, frames = vehicles.rows, vehicles.states, vehicles.bodies, out.shape[0]
    dt, brakes, recent = motion.dt, bodies.brakes, bodies.recent
    budget, action, swing, reach = bodies.budget[j], bodies.action[j], bodies.swing[j], bodies.reach[j]
    v, wrecked = states[j, 3], others[j, _CRASHED] > 0
    least_speed, start, floor = min(v, 0.0 if wrecked else motion.min_speed), states[j, 0] - reach, bodies.floor[j]
    way, time, back, lost = 0.0, 0.0, 0.0, 0.0
    recent_action, second, speed = 0.0, recent.shape[1], v
    for k in range(frames):
        # What turning may take in the second that ends with this frame, and in the seconds after it.
        if k % second == 0:
            recent_action += swing * motion.action_in_one_second
            for i in range(second - 1):
                recent_action -= recent[j, i]
        else:
            recent_action += recent[j, second - 1 - k % second]
        slow = max(speed, least_speed)
        rate = _rate(brakes, j, k - hold, motion) if k >= hold else 0.0
        if wrecked:
            rate = max(rate, speed)  # highway-env: a crashed vehicle brakes at -1 * speed per second
        speed -= rate * dt
        if hold > 0:
            way += max(slow, 0.0) * dt
            along = way
        else:
            if slow >= motion.slow:
                way, time = way + slow * dt, time + dt
                # `_lost` written out: here the speed is at least `Motion.slow`, and `action_in_one_second` bounds the
                # action too.
                gone = max(budget, 0.0) + motion.loss_back * time
                lost = min(gone, min(max(action, 0.0) + motion.action_back * time, max(recent_action, 0.0)) / slow)
            else:
                lost, back = _lost(budget, action, 0.0, time, motion), back + max(motion.reversing, -v) * dt
            along = max(way - lost, 0.0)
        if stretch.shape[1] > 0:
            along = min(along * stretch[0, j], along * stretch[1, j])
        rear = start + along
        # At rest it may reverse, down to its floor.
        if hold == 0 and rear > floor - reach:
            rear = max(rear - back, floor - reach)
        out[k] = rear


@kernel_inline
def least_next_position(
    j: int, states: FloatArray, stretch: FloatArray, motion: Motion, bodies: ReachableBodies
) -> float:
    """Least s of the centre of vehicle `j` after one frame [m], by the bounds of `rear_of`."""
    v, floor, recent, along, back = states[j, 3], bodies.floor[j], bodies.recent, 0.0, 0.0
    if v >= motion.slow:
        recent_action = bodies.swing[j] * motion.action_in_one_second
        for i in range(recent.shape[1] - 1):
            recent_action -= recent[j, i]
        lost = min(_lost(bodies.budget[j], bodies.action[j], v, motion.dt, motion), max(recent_action, 0.0) / v)
        along = max(v * motion.dt - lost, 0.0)
    else:
        back = max(motion.reversing, -v) * motion.dt
    if stretch.shape[1] > 0:
        along = min(along * stretch[0, j], along * stretch[1, j])
    place = states[j, 0] + along
    return max(place - back, floor) if place > floor else place


@kernel_no_refcount
def rears(
    rows: IntArray, vehicles: VehicleBodies, stretch: FloatArray, motion: Motion, hold: int, out: FloatArray
) -> None:
    """`rear_of` the vehicles `rows` (n,) after each frame, `out` (n, K) [m], written. The last column bounds all later
    frames as well."""
    frames, bodies = out.shape[1], vehicles.bodies
    for n in range(rows.shape[0]):
        j = rows[n]
        rear_of(j, vehicles, stretch, motion, hold, out[n])
        if hold == 0 and frames > 0:
            out[n, frames - 1] = min(out[n, frames - 1], bodies.floor[j] - bodies.reach[j])


@kernel_inline
def front_of(j: int, vehicles: VehicleBodies, stretch: FloatArray, motion: Motion, hold: int, out: FloatArray) -> None:
    """Greatest s of the body of vehicle `j` after each frame, `out` (frames,) [m], written; `stretch` and `hold` as in
    `rear_of`."""
    states, bodies, frames = vehicles.states, vehicles.bodies, out.shape[0]
    dt, start = motion.dt, states[j, 0] + bodies.reach[j]
    v, way = states[j, 3], 0.0
    top, most = max(v, motion.max_speed), stretch[1, j] if stretch.shape[1] > 0 else 1.0
    for k in range(frames):
        # A reversing vehicle may turn, and then moves back by less than its speed; so it counts as standing.
        way += max(v, 0.0) * dt * most
        out[k] = start + way
        if k >= hold:
            v = min(v + min(motion.acceleration, motion.power / max(v, 1e-3)) * dt, top)


@kernel_no_refcount
def fronts(
    rows: IntArray, vehicles: VehicleBodies, stretch: FloatArray, motion: Motion, hold: int, out: FloatArray
) -> None:
    """`front_of` the vehicles `rows` (n,) after each frame, `out` (n, K) [m], written."""
    for n in range(rows.shape[0]):
        front_of(rows[n], vehicles, stretch, motion, hold, out[n])
