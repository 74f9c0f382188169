"""How hard each vehicle may brake, and when: no harder than what is ahead of it asks for.

Nobody brakes hard for nothing. The Intelligent Driver Model brakes at

    a0 (d* / d)^2        d* = d0 + T v + v (v - v_leader) / (2 sqrt(a b))

for what is at distance d ahead, and a lane change in front of another must not ask more of it than MOBIL lets. So the
hardest braking of each vehicle at each coming frame follows from the hardest of those ahead: v as fast as may be, the
leader as slow, and the distance as short. What has not come in yet counts from when it may, the other way round. Those
extremes contain those of any later frame, and so the bound contains itself.

Sources: Treiber, Hennecke and Helbing 2000 (IDM); Kesting, Treiber and Helbing 2007 (MOBIL).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.compiled import inlined, uncounted
from dynamics.state import FloatArray, IntArray, Vehicle
from dynamics.traffic.mobil import COMFORT, GAP, IMPOSED, TIME, TWICE_ROOT, desired_gap
from dynamics.traffic.occupancy_kernels import apart
from dynamics.traffic.tables import Bodies, Motion

__all__ = ["brakings"]

_CRASHED = int(Vehicle.CRASHED)
_FAR = 600.0
"""What is further ahead asks for no braking beyond `Motion.calm` [m]."""
_SCALE, _SLACK = 1.1, 0.5
"""How much harder than IDM one may brake: as a share of it, and in addition [m/s^2]."""
_MORE = 0.2
"""By how much MOBIL's bound on what a lane change imposes may be exceeded, as a multiple of the distance."""
_PER_TWICE_ROOT, _PER_SCALE, _ROUNDING = 1 / TWICE_ROOT, 1 / (_SCALE * COMFORT), 1e-9
"""Reciprocals, and more than what comes of taking them for divisors, relatively."""
_LANE, _TOWARDS = 5.0, 14.0
"""Two that are further apart across the road than this [m] have to come nearer first, at this speed at most [m/s]."""


@uncounted
def _slowest(
    v: float,
    backwards: float,
    brakes: FloatArray,
    wrecked: bool,
    least: float,
    most: float,
    motion: Motion,
    speeds: FloatArray,
    ways: FloatArray,
) -> None:
    """Least speed at each of the coming frames of one that brakes at `brakes` (K,), down to `backwards` [m/s], and how
    far that has led, at between `least` and `most` metres of the road in a metre driven."""
    way, dt = 0.0, motion.dt
    for k in range(speeds.shape[0]):
        speeds[k], ways[k] = v, min(way * least, way * most)
        way += v * dt
        # highway-env: a crashed vehicle brakes at -1 * speed per second.
        v = max(min(v - brakes[k] * dt, v * (1 - dt) if wrecked else v), backwards)


@inlined
def _asked(d: float, fast: float, slow: float, motion: Motion) -> float:
    """Braking at speed `fast` for what is at distance d ahead, and at speed `slow` [m/s^2]."""
    share = desired_gap(fast, max(fast - slow, 0.0)) / d
    rate = min(_SCALE * COMFORT * (share * share) + _SLACK, motion.braking)
    return rate if d > 1.0 else motion.braking


@inlined
def _asks(d: float, fast: float, slow: float, motion: Motion) -> bool:
    """Whether `_asked` is more than `Motion.calm`: without a division, but where rounding could tell."""
    if d > 1.0:
        wanted = GAP + TIME * fast + fast * max(fast - slow, 0.0) * _PER_TWICE_ROOT
        square, limit = wanted * wanted, (motion.calm - _SLACK) * _PER_SCALE * (d * d)
        if square < limit * (1 - _ROUNDING):
            return False
        if square > limit * (1 + _ROUNDING):
            return motion.braking > motion.calm
    return _asked(d, fast, slow, motion) > motion.calm


@inlined
def _lets_in(v: float, closing: float, far: float) -> bool:
    """Whether MOBIL lets one in that is `far` ahead [m] of another at speed v, which closes in on it: likewise."""
    most, term = (IMPOSED + _MORE) * far, v * closing * _PER_TWICE_ROOT
    over = GAP + TIME * v + term - most
    band = _ROUNDING * (GAP + TIME * abs(v) + abs(term) + abs(most))
    if over > band or over < -band:
        return over < 0
    return desired_gap(v, closing) <= most


class _Extremes(NamedTuple):
    """Speeds of each vehicle at each of the coming frames, and how far they have led by then, each (m, K): as fast, and
    as slow, as it may be; and as slow as anybody could be that goes forwards."""

    fast: FloatArray
    fast_way: FloatArray
    slow: FloatArray
    slow_way: FloatArray
    slowest: FloatArray
    slowest_way: FloatArray


@inlined
def _press(
    i: int,
    j: int,
    ahead: float,
    near: float,
    first: int,
    x: _Extremes,
    motion: Motion,
    brakes: FloatArray,
    end: int,
    rates: FloatArray,
) -> int:
    """Raise `brakes` (K,) of vehicle i to what vehicle j may ask for that is `ahead` of it, and no nearer than `near`
    [m]: at once where `first` is negative, and else from the frame at which it may move in, no sooner than `first`.
    `rates` (K,) are written over.

    Returns how many frames there are before i may brake as hard as can be, `end` at most.
    """
    back, begin = motion.loss_back * motion.dt, 0
    if first >= 0:
        begin = end
        for k in range(first, end):
            far, v = ahead + x.fast_way[j, k] - x.slowest_way[i, k], x.slowest[i, k]
            # One from beyond the next lane looks out for those who are in that lane now, and not for who enters it too.
            if far > 0 and (first > 0 or _lets_in(v, v - x.fast[j, k], far)):
                begin = k
                break
    slow_way, fast_way, fast, slow = x.slow_way[j], x.fast_way[i], x.fast[i], x.slow[j]
    for k in range(begin, end):
        rates[k] = _asked(near + slow_way[k] - fast_way[k] - back * k, fast[k], slow[k], motion)
    for k in range(begin, end):
        brakes[k] = max(brakes[k], rates[k])
        if rates[k] >= motion.braking:
            return k + 1
    return end


@uncounted
def _extremes(
    others: FloatArray, states: FloatArray, stretch: FloatArray, motion: Motion, frames: int, ways: FloatArray
) -> None:
    """Fill in `_Extremes` for so many frames, the first six of `ways` (see `brakings`), where everybody may brake as
    hard as can be at once.

    It goes frame by frame over all vehicles: none of them waits for what comes of another's last frame.
    """
    m, dt, curved = states.shape[0], motion.dt, stretch.shape[1] > 0
    fast, slow, slowest = ways[6, 0, :m], ways[6, 1, :m], ways[6, 2, :m]
    fast_way, slow_way, slowest_way = ways[6, 3, :m], ways[6, 4, :m], ways[6, 5, :m]
    for i in range(m):
        fast[i] = slow[i] = slowest[i] = max(states[i, 3], 0.0)
        fast_way[i] = slow_way[i] = slowest_way[i] = 0.0
    for k in range(frames):
        for i in range(m):
            least, most = (stretch[0, i], stretch[1, i]) if curved else (1.0, 1.0)
            ways[0, i, k], ways[1, i, k] = fast[i], fast_way[i] * most
            ways[2, i, k], ways[3, i, k] = slow[i], min(slow_way[i] * least, slow_way[i] * most)
            ways[4, i, k], ways[5, i, k] = slowest[i], min(slowest_way[i] * least, slowest_way[i] * most)
        for i in range(m):
            v, top = fast[i], max(states[i, 3], motion.max_speed)
            fast_way[i] += v * dt
            fast[i] = min(v + min(motion.acceleration, motion.power / max(v, 1e-3)) * dt, top)
            v = slowest[i]
            slowest_way[i] += v * dt
            slowest[i] = max(v - motion.braking * dt, 0.0)
            v, wrecked = slow[i], others[i, _CRASHED] > 0
            slow_way[i] += v * dt
            backwards = min(states[i, 3], 0.0 if wrecked else -motion.reversing)
            slow[i] = max(min(v - motion.braking * dt, v * (1 - dt) if wrecked else v), backwards)


@uncounted
def brakings(
    others: FloatArray,
    states: FloatArray,
    stretch: FloatArray,
    motion: Motion,
    lap: float,
    ego: float,
    order: IntArray,
    bodies: Bodies,
    ways: FloatArray,
) -> None:
    """Fill in `brakes` from vehicle rows (m, 7), road states (m, 4), and the least and greatest metres of s in a metre
    driven, (2, m), or no columns on a straight road.

    Parameters
    ----------
    lap : length of a closed road, 0 of an open one [m].
    ego : where the ego is along the road [m]; whoever is behind it may have it to brake for. NaN without one.
    order : the vehicles from the first along the road to the last, (m,).
    ways : room that is written over, (7, at least m and 6, at least K and m).
    """
    m, frames, last = states.shape[0], bodies.brakes.shape[1], bodies.brakes.shape[1] - 1
    curved = stretch.shape[1] > 0
    for i in range(m):
        for k in range(frames):
            bodies.brakes[i, k] = motion.braking
    if not motion.calm < motion.braking:
        return
    low, high, starts, ends = bodies.low, bodies.high, bodies.first, bodies.last
    all_brakes, budget = bodies.brakes, bodies.budget
    x = _Extremes(ways[0], ways[1], ways[2], ways[3], ways[4], ways[5])
    _extremes(others, states, stretch, motion, frames, ways)
    furthest = 0.0
    for j in range(m):
        way = x.fast_way[j, last]
        furthest = max(furthest, way) if way == way else np.inf
    for n in range(m):
        i, end = order[n], frames
        behind, brakes = ego - states[i, 0], all_brakes[i]
        if lap > 0:
            behind -= lap * np.rint(behind / lap)
        if behind > 0 or others[i, _CRASHED] > 0:
            continue
        for k in range(frames):
            brakes[k] = motion.calm
        # The nearest first: what may make it brake as hard as can be leaves less to be looked at in the others.
        for other in range(m):
            j = order[n - 1 - other] if other < n else order[other]
            ahead = states[j, 0] - states[i, 0]
            if lap > 0:
                ahead -= lap * np.rint(ahead / lap)
            if other >= n and lap == 0 and ahead + furthest - x.slowest_way[i, last] <= 0:
                break  # nor does anybody get ahead who is further behind
            if i == j or not abs(ahead) <= _FAR:
                continue
            if ahead <= 0 and ahead + x.fast_way[j, last] - x.slowest_way[i, last] <= 0:
                continue  # it does not get ahead
            # The distance is least at one of its ends: it falls ever faster. What is wanted grows.
            near = ahead - max(budget[j], 0.0)
            d = near + x.slow_way[j, last] - x.fast_way[i, last] - motion.loss_back * motion.dt * last
            if not _asks(min(near, d), x.fast[i, last], x.slow[j, last], motion):
                continue  # nor does it ask for anything
            first = -1
            if apart(starts, ends, low, high, i, j):
                first = max(int((abs(states[j, 1] - states[i, 1]) - _LANE) / (_TOWARDS * motion.dt)), 0)
            if first < end and (first >= 0 or ahead >= 0):
                end = _press(i, j, ahead, near, first, x, motion, brakes, end, ways[6, 0])
                if end == 1 and brakes[0] >= motion.braking:
                    break
        for k in range(end, frames):
            brakes[k] = motion.braking
        # Those behind count on it.
        v, least, most = states[i, 3], stretch[0, i] if curved else 1.0, stretch[1, i] if curved else 1.0
        _slowest(v, min(v, -motion.reversing), brakes, False, least, most, motion, x.slow[i], x.slow_way[i])
