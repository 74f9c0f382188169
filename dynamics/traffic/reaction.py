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
    """Speeds of each vehicle at each of the coming frames, and how far they have led by then, each (K, m) or larger: as
    fast, and as slow, as it may be; and as slow as anybody could be that goes forwards."""

    fast: FloatArray
    fast_way: FloatArray
    slow: FloatArray
    slow_way: FloatArray
    slowest: FloatArray
    slowest_way: FloatArray


@inlined
def _little(d: float, fast: float, slow: float, braking: float) -> bool:
    """Whether `_asked` is less than a braking for sure [m/s^2], by more than rounding could take from it."""
    wanted = GAP + TIME * fast + fast * max(fast - slow, 0.0) * _PER_TWICE_ROOT
    return d > 1.0 and wanted * wanted < (braking - _SLACK) * _PER_SCALE * (d * d) * (1 - _ROUNDING)


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
) -> int:
    """Raise `brakes` (K,) of vehicle i to what vehicle j may ask for that is `ahead` of it, and no nearer than `near`
    [m]: at once where `first` is negative, and else from the frame at which it may move in, no sooner than `first`.

    Returns how many frames there are before i may brake as hard as can be, `end` at most.
    """
    back, begin = motion.loss_back * motion.dt, 0
    if first >= 0:
        begin = end
        for k in range(first, end):
            far, v = ahead + x.fast_way[k, j] - x.slowest_way[k, i], x.slowest[k, i]
            # One from beyond the next lane looks out for those who are in that lane now, and not for who enters it too.
            if far > 0 and (first > 0 or _lets_in(v, v - x.fast[k, j], far)):
                begin = k
                break
    for k in range(begin, end):
        d = near + x.slow_way[k, j] - x.fast_way[k, i] - back * k
        if _little(d, x.fast[k, i], x.slow[k, j], brakes[k]):
            continue  # somebody else asks for more
        rate = _asked(d, x.fast[k, i], x.slow[k, j], motion)
        brakes[k] = max(brakes[k], rate)
        if rate >= motion.braking:
            return k + 1
    return end


@uncounted
def _extremes(
    others: FloatArray, states: FloatArray, stretch: FloatArray, motion: Motion, frames: int, ways: FloatArray
) -> None:
    """Fill in so many frames of `_Extremes`, the first six of `ways` (see `brakings`), where everybody may brake as
    hard as can be at once.

    It goes frame by frame over all vehicles, one quantity at a time and in contiguous rows: so the compiler takes
    several vehicles at once.
    """
    m, dt, curved = states.shape[0], motion.dt, stretch.shape[1] > 0
    fast, fast_way, slow, slow_way, slowest, slowest_way = ways[0], ways[1], ways[2], ways[3], ways[4], ways[5]
    top, kept, backwards = ways[6, 0], ways[6, 1], ways[6, 2]
    acceleration, power, braked = motion.acceleration, motion.power, motion.braking * dt
    for i in range(m):
        v, wrecked = states[i, 3], others[i, _CRASHED] > 0
        fast[0, i] = slow[0, i] = slowest[0, i] = max(v, 0.0)
        fast_way[0, i] = slow_way[0, i] = slowest_way[0, i] = 0.0
        top[i], backwards[i] = max(v, motion.max_speed), min(v, 0.0 if wrecked else -motion.reversing)
        kept[i] = 1 - dt if wrecked else 1.0
    for k in range(1, frames):
        speeds, way, following, then = fast[k - 1], fast_way[k - 1], fast[k], fast_way[k]
        for i in range(m):
            v = speeds[i]
            then[i] = way[i] + v * dt
            following[i] = min(v + min(acceleration, power / max(v, 1e-3)) * dt, top[i])
        speeds, way, following, then = slowest[k - 1], slowest_way[k - 1], slowest[k], slowest_way[k]
        for i in range(m):
            v = speeds[i]
            then[i] = way[i] + v * dt
            following[i] = max(v - braked, 0.0)
        speeds, way, following, then = slow[k - 1], slow_way[k - 1], slow[k], slow_way[k]
        for i in range(m):
            v = speeds[i]
            then[i] = way[i] + v * dt
            following[i] = max(min(v - braked, v * kept[i]), backwards[i])
    if curved:
        for k in range(frames):
            for i in range(m):
                least, most = stretch[0, i], stretch[1, i]
                fast_way[k, i] *= most
                slow_way[k, i] = min(slow_way[k, i] * least, slow_way[k, i] * most)
                slowest_way[k, i] = min(slowest_way[k, i] * least, slowest_way[k, i] * most)


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
    ways : room that is written over, (7, K or 3, at least m and K).
    """
    m, frames, last = states.shape[0], bodies.brakes.shape[1], bodies.brakes.shape[1] - 1
    curved, all_brakes, budget = stretch.shape[1] > 0, bodies.brakes, bodies.budget
    if not motion.calm < motion.braking:
        for i in range(m):
            for k in range(frames):
                all_brakes[i, k] = motion.braking
        return
    low, high, starts, ends = bodies.low, bodies.high, bodies.first, bodies.last
    x, back = _Extremes(ways[0], ways[1], ways[2], ways[3], ways[4], ways[5]), motion.loss_back * motion.dt
    _extremes(others, states, stretch, motion, frames, ways)
    gets, slows, goes = x.fast_way[last], x.slow[last], x.slow_way[last]
    furthest = 0.0
    for j in range(m):
        furthest = max(furthest, gets[j]) if gets[j] == gets[j] else np.inf
    for n in range(m):
        i, end = order[n], frames
        behind, brakes = ego - states[i, 0], all_brakes[i]
        if lap > 0:
            behind -= lap * np.rint(behind / lap)
        if behind > 0 or others[i, _CRASHED] > 0:
            for k in range(frames):
                brakes[k] = motion.braking
            continue
        for k in range(frames):
            brakes[k] = motion.calm
        least, most, fast = x.slowest_way[last, i], gets[i], x.fast[last, i]
        # The nearest first: what may make it brake as hard as can be leaves less to be looked at in the others.
        for other in range(m):
            j = order[n - 1 - other] if other < n else order[other]
            ahead = states[j, 0] - states[i, 0]
            if lap > 0:
                ahead -= lap * np.rint(ahead / lap)
            if other >= n and lap == 0 and ahead + furthest - least <= 0:
                break  # nor does anybody get ahead who is further behind
            if i == j or not abs(ahead) <= _FAR:
                continue
            if ahead <= 0 and ahead + gets[j] - least <= 0:
                continue  # it does not get ahead
            # The distance is least at one of its ends: it falls ever faster. What is wanted grows.
            near, k = ahead - max(budget[j], 0.0), end - 1
            d = near + x.slow_way[k, j] - x.fast_way[k, i] - back * k
            if _little(min(near, d), x.fast[k, i], x.slow[k, j], motion.calm):
                continue  # it asks for nothing before this one may brake as hard as can be anyway
            d = near + goes[j] - most - back * last
            if not _asks(min(near, d), fast, slows[j], motion):
                continue  # nor does it ask for anything
            first = -1
            if apart(starts, ends, low, high, i, j):
                first = max(int((abs(states[j, 1] - states[i, 1]) - _LANE) / (_TOWARDS * motion.dt)), 0)
            if first < end and (first >= 0 or ahead >= 0):
                end = _press(i, j, ahead, near, first, x, motion, brakes, end)
                if end == 1 and brakes[0] >= motion.braking:
                    break
        for k in range(end, frames):
            brakes[k] = motion.braking
        # Those behind count on it.
        v, shortest, longest = states[i, 3], stretch[0, i] if curved else 1.0, stretch[1, i] if curved else 1.0
        speeds, way = x.slow[:frames, i], x.slow_way[:frames, i]
        _slowest(v, min(v, -motion.reversing), brakes, False, shortest, longest, motion, speeds, way)
