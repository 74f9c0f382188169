"""The loops of the occupancy: one pass over the vehicles, and one over vehicles and frames.

`dynamics.traffic.occupancy` says what the quantities are and where they come from.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import inlined, uncounted
from dynamics.state import FloatArray, IntArray, Vehicle
from dynamics.traffic.tables import Bodies, Motion

__all__ = ["Lanes", "apart", "coming_place", "floors", "front_of", "fronts", "rear_of", "rears", "spend", "strips"]

_SPEED, _LENGTH, _WIDTH, _CRASHED = int(Vehicle.SPEED), int(Vehicle.LENGTH), int(Vehicle.WIDTH), int(Vehicle.CRASHED)
_ENDLESS = 1e6
"""Way of a vehicle that is assumed never to stop [m]."""


class Lanes(NamedTuple):
    """Lanes, and how far a body may reach over a marking before it counts as being in the next lane too.

    `centers` (lanes,) [m], `width` [m], `lean` [m]; `waver` [m]: how far from the middle of its lane a body may come
    that keeps to it; `dt`: duration of a frame [s].
    """

    centers: FloatArray
    width: float
    lean: float
    waver: float
    dt: float


@uncounted
def strips(others: FloatArray, states: FloatArray, growth: FloatArray, lanes: Lanes, bodies: Bodies) -> None:
    """Fill in lane, first, last, low, high and reach from vehicle rows (m, 7), road states (m, 4) and what a bend adds
    to each body along and across, (m, 2) [m], or no rows on a straight road; NaN for a vehicle whose row is."""
    centers, count = lanes.centers, lanes.centers.shape[0]
    # Out of a loop: it is slow to get an array out of a tuple.
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
        # highway-env counts what constant velocity along the heading would bring within a frame.
        drift = v * sin * lanes.dt
        low, high = r - half + min(drift, 0.0), r + half + max(drift, 0.0)
        here = int(min(max(np.rint((r - centers[0]) / lanes.width), 0), count - 1))
        side, core = 0.5 * lanes.width + lanes.lean, 0.5 * width + lanes.waver
        first, last = count, -1
        for j in range(count):
            if high > centers[j] - side + 2 * lanes.lean and low < centers[j] + side - 2 * lanes.lean:
                first, last = min(first, j), max(last, j)
        lane[i], starts[i], ends[i] = here, first, last
        if first <= last:
            # Up to the marking; or up to as far as one wavers that is in the middle of that lane, or on its way there.
            least, most = centers[first] - side, centers[last] + side
            if low >= centers[first] - core:
                least = centers[first] - core
            if high <= centers[last] + core:
                most = centers[last] + core
            low, high = min(low, least), max(high, most)
        along, across = (growth[i, 0], growth[i, 1]) if growth.shape[0] > 0 else (0.0, 0.0)
        lows[i], highs[i] = low - across, high + across
        if length != shape[0] or width != shape[1]:  # most are alike
            shape = (length, width, 0.5 * math.hypot(length, width))
        reach[i] = shape[2] + along


@uncounted
def spend(
    states0: FloatArray,
    bodies0: Bodies,
    states: FloatArray,
    stretch: FloatArray,
    motion: Motion,
    lap: float,
    bodies: Bodies,
) -> None:
    """Fill in `budget`, `action` and `recent` from the frame before: what was left, and what has come back, less what
    turning has taken of each vehicle's way. `lap` is the length of a closed road, 0 of an open one [m]."""
    left, left_action, before = bodies0.budget, bodies0.action, bodies0.recent
    budgets, actions, recent, swings = bodies.budget, bodies.action, bodies.recent, bodies.swing
    for i in range(states.shape[0]):
        v, swing, lost = states0[i, 3], swings[i], 0.0
        if v >= motion.slow:
            ds = states[i, 0] - states0[i, 0]
            if lap > 0:
                ds -= lap * np.rint(ds / lap)
            # In metres driven, as the bounds take it: `stretch` makes metres of s of it.
            lost = max(v * motion.dt - (ds / stretch[0, i] if stretch.shape[1] > 0 else ds), 0.0)
        budget, action = motion.loss_back * motion.dt, motion.action_back * motion.dt
        budgets[i] = min(max(left[i], 0.0) + budget, swing * motion.loss) - lost
        actions[i] = min(max(left_action[i], 0.0) + action, swing * motion.action) - v * lost
        within = v * lost
        recent[i, 0] = within
        for k in range(recent.shape[1] - 1):
            within += before[i, k]
            recent[i, k + 1] = before[i, k]
        if within > swing * motion.burst:
            actions[i] = min(actions[i], swing * motion.burst - within)


@inlined
def _lost(budget: float, action: float, slow: float, time: float, motion: Motion) -> float:
    """What a vehicle can have lost by turning after `time` [s], at no less than `slow` [m/s], [m]."""
    budget = max(budget, 0.0) + motion.loss_back * time
    action = max(action, 0.0) + motion.action_back * time
    return min(budget, action / max(slow, motion.slow))


@inlined
def apart(first: IntArray, last: IntArray, low: FloatArray, high: FloatArray, i: int, j: int) -> bool:
    """Whether two vehicles are in different lanes, by arrays of `Bodies`: in a loop it is slow to get these out."""
    if first[i] > last[i] or first[j] > last[j]:
        return low[j] >= high[i] or high[j] <= low[i]
    # Strips of neighbouring lanes overlap by what may lean.
    return first[j] > last[i] or last[j] < first[i]


@inlined
def _rate(brakes: FloatArray, i: int, k: int, motion: Motion) -> float:
    """How hard a vehicle may brake at the coming frame k [m/s^2]."""
    return brakes[i, k] if k < brakes.shape[1] else motion.braking


@uncounted
def _braking_way(i: int, v: float, wrecked: bool, brakes: FloatArray, motion: Motion) -> tuple[float, float]:
    """The way that a vehicle counts on before it stands, braking from now on [m], and for how long it does [s]."""
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


@uncounted
def floors(
    others: FloatArray, states: FloatArray, stretch: FloatArray, motion: Motion, order: IntArray, bodies: Bodies
) -> None:
    """Fill in `floor`: where a vehicle's centre comes to rest at the least, or as far behind what is ahead in its lanes
    as it may reverse to. A vehicle that reverses runs out within `motion.runout`."""
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


@inlined
def rear_of(
    j: int,
    others: FloatArray,
    states: FloatArray,
    stretch: FloatArray,
    motion: Motion,
    bodies: Bodies,
    hold: int,
    frames: int,
    out: FloatArray,
) -> None:
    """Least s of the body of vehicle `j` after 1..`frames` frames, `out` (frames or more,) [m].

    `stretch` (2, m) has the least and greatest metres of s in a metre driven; no columns on a straight road. `hold`
    frames at constant speed are expected before the worst case starts; then the result is a forecast and no bound.
    """
    dt, brakes, recent = motion.dt, bodies.brakes, bodies.recent
    budget, action, swing, reach = bodies.budget[j], bodies.action[j], bodies.swing[j], bodies.reach[j]
    v, wrecked = states[j, 3], others[j, _CRASHED] > 0
    least_speed, start, floor = min(v, 0.0 if wrecked else motion.min_speed), states[j, 0] - reach, bodies.floor[j]
    way, time, back, lost = 0.0, 0.0, 0.0, 0.0
    burst, second, speed = 0.0, recent.shape[1], v
    for k in range(frames):
        # What turning may take of a second that ends with this frame, and of those after it.
        if k % second == 0:
            burst += swing * motion.burst
            for i in range(second - 1):
                burst -= recent[j, i]
        else:
            burst += recent[j, second - 1 - k % second]
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
                # The least of both is divided by the speed, which is above `Motion.slow`.
                gone = max(budget, 0.0) + motion.loss_back * time
                lost = min(gone, min(max(action, 0.0) + motion.action_back * time, max(burst, 0.0)) / slow)
            else:
                lost, back = _lost(budget, action, 0.0, time, motion), back + max(motion.reversing, -v) * dt
            along = max(way - lost, 0.0)
        if stretch.shape[1] > 0:
            along = min(along * stretch[0, j], along * stretch[1, j])
        rear = start + along
        # Once it stands it may reverse, as far as to its floor.
        if hold == 0 and rear > floor - reach:
            rear = max(rear - back, floor - reach)
        out[k] = rear


@inlined
def coming_place(j: int, states: FloatArray, stretch: FloatArray, motion: Motion, bodies: Bodies) -> float:
    """Least s of the centre of vehicle `j` after one frame [m], as `rear_of` bounds its body."""
    v, floor, recent, along, back = states[j, 3], bodies.floor[j], bodies.recent, 0.0, 0.0
    if v >= motion.slow:
        burst = bodies.swing[j] * motion.burst
        for i in range(recent.shape[1] - 1):
            burst -= recent[j, i]
        lost = min(_lost(bodies.budget[j], bodies.action[j], v, motion.dt, motion), max(burst, 0.0) / v)
        along = max(v * motion.dt - lost, 0.0)
    else:
        back = max(motion.reversing, -v) * motion.dt
    if stretch.shape[1] > 0:
        along = min(along * stretch[0, j], along * stretch[1, j])
    place = states[j, 0] + along
    return max(place - back, floor) if place > floor else place


@uncounted
def rears(
    rows: IntArray,
    others: FloatArray,
    states: FloatArray,
    stretch: FloatArray,
    motion: Motion,
    bodies: Bodies,
    hold: int,
    out: FloatArray,
) -> None:
    """`rear_of` vehicles `rows` (n,) after each frame, `out` (n, K) [m]; the last frame stands for all that follow
    it."""
    frames = out.shape[1]
    for n in range(rows.shape[0]):
        j = rows[n]
        rear_of(j, others, states, stretch, motion, bodies, hold, frames, out[n])
        if hold == 0 and frames > 0:
            out[n, frames - 1] = min(out[n, frames - 1], bodies.floor[j] - bodies.reach[j])


@inlined
def front_of(
    j: int,
    states: FloatArray,
    stretch: FloatArray,
    motion: Motion,
    bodies: Bodies,
    hold: int,
    frames: int,
    out: FloatArray,
) -> None:
    """Greatest s of the body of vehicle `j` after 1..`frames` frames, `out` (frames or more,) [m]; `stretch` and `hold`
    as in `rear_of`."""
    dt, start = motion.dt, states[j, 0] + bodies.reach[j]
    v, way = states[j, 3], 0.0
    top, most = max(v, motion.max_speed), stretch[1, j] if stretch.shape[1] > 0 else 1.0
    for k in range(frames):
        # One that reverses may turn, and then gets back by less than its speed.
        way += max(v, 0.0) * dt * most
        out[k] = start + way
        if k >= hold:
            v = min(v + min(motion.acceleration, motion.power / max(v, 1e-3)) * dt, top)


@uncounted
def fronts(
    rows: IntArray, states: FloatArray, stretch: FloatArray, motion: Motion, bodies: Bodies, hold: int, out: FloatArray
) -> None:
    """`front_of` vehicles `rows` (n,) after each frame, `out` (n, K) [m]."""
    for n in range(rows.shape[0]):
        front_of(rows[n], states, stretch, motion, bodies, hold, out.shape[1], out[n])
