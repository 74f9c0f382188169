"""How hard each vehicle may brake at each coming frame: no harder than the vehicles ahead require.

The Intelligent Driver Model brakes at

    a0 (d* / d)^2        d* = d0 + T v + v (v - v_leader) / (2 sqrt(a b))

for a leader at distance d. A lane change in front of a vehicle must not require more braking of it than MOBIL permits.
So the hardest braking of each vehicle follows from that of the vehicles ahead. It takes the greatest speed of the
vehicle, the least speed of the leader, and the shortest distance. A vehicle that may still move in ahead counts from
the first frame at which MOBIL could permit that. That frame is found from the opposite extremes: the vehicle as slow,
and the other as fast, as possible. These extremes contain the extremes of every later frame, so a bound of now covers
the bounds of later frames.

Sources: Treiber, Hennecke and Helbing 2000 (IDM); Kesting, Treiber and Helbing 2007 (MOBIL).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.state import FloatArray, IntArray, Vehicle
from dynamics.traffic.mobil import COMFORT, GAP, IMPOSED, TIME, TWICE_ROOT, desired_gap
from dynamics.traffic.occupancy_kernels import apart, lap_distance
from dynamics.traffic.tables import Motion, ReachableBodies, VehicleBodies

__all__ = ["LapPosition", "ReactionWork", "hardest_braking"]

_CRASHED = int(Vehicle.CRASHED)
_FAR = 600.0
"""Distance ahead beyond which a vehicle requires no braking beyond `Motion.comfortable_braking` [m]."""
_SCALE, _SLACK = 1.1, 0.5
"""How much harder than IDM a vehicle may brake: as a factor, and in addition [m/s^2]."""
_MORE = 0.2
"""By how much d* / d of a new follower may exceed MOBIL's bound `IMPOSED`."""
_PER_TWICE_ROOT, _PER_SCALE, _ROUNDING = 1 / TWICE_ROOT, 1 / (_SCALE * COMFORT), 1e-9
"""Reciprocals, and a relative bound on the rounding error of multiplying by them instead of dividing."""
_LANE, _TOWARDS = 5.0, 14.0
"""Two vehicles further apart across the road than `_LANE` [m] first have to approach, at no more than `_TOWARDS`
[m/s]."""


class LapPosition(NamedTuple):
    """Position of the ego along a road.

    Attributes
    ----------
    lap : length of a closed road, 0 of an open one [m].
    ego : position of the ego along the road [m], NaN without one. A vehicle behind it may brake at `Motion.braking`.
    """

    lap: float
    ego: float


class ReactionWork(NamedTuple):
    """Buffers of `hardest_braking`.

    Attributes
    ----------
    order : the vehicles in the order of `dynamics.traffic.occupancy.order_by_position`, (m,).
    ways : overwritten, (7, K or 3, at least m and K).
    """

    order: IntArray
    ways: FloatArray


@kernel_no_refcount
def _slowest(
    v: float,
    backwards: float,
    brakes: FloatArray,
    stretch: tuple[float, float],
    dt: float,
    speeds: FloatArray,
    ways: FloatArray,
) -> None:
    """Least speed and least distance driven, at each of the coming frames, of a vehicle that brakes at `brakes` (K,).

    Parameters
    ----------
    v : its speed [m/s]. backwards : least speed [m/s].
    stretch : least and greatest metres of s in a metre driven. dt : duration of a frame [s].
    speeds, ways : (K,) [m/s] and [m], written.
    """
    way = 0.0
    for k in range(speeds.shape[0]):
        speeds[k], ways[k] = v, min(way * stretch[0], way * stretch[1])
        way += v * dt
        v = max(min(v - brakes[k] * dt, v), backwards)


@kernel_inline
def _required_braking(d: float, fast: float, slow: float, motion: Motion) -> float:
    """Braking by IDM at speed `fast`, for a leader at distance d and at speed `slow` [m/s^2]."""
    share = desired_gap(fast, max(fast - slow, 0.0)) / d
    rate = min(_SCALE * COMFORT * (share * share) + _SLACK, motion.braking)
    return rate if d > 1.0 else motion.braking


@kernel_inline
def _requires_braking(d: float, fast: float, slow: float, motion: Motion) -> bool:
    """Whether `_required_braking` exceeds `Motion.comfortable_braking`. It divides only where rounding could change
    the answer."""
    if d > 1.0:
        wanted = GAP + TIME * fast + fast * max(fast - slow, 0.0) * _PER_TWICE_ROOT
        square, limit = wanted * wanted, (motion.comfortable_braking - _SLACK) * _PER_SCALE * (d * d)
        if square < limit * (1 - _ROUNDING):
            return False
        if square > limit * (1 + _ROUNDING):
            return motion.braking > motion.comfortable_braking
    return _required_braking(d, fast, slow, motion) > motion.comfortable_braking


@kernel_inline
def _permits_cut_in(v: float, closing: float, far: float) -> bool:
    """Whether MOBIL permits a vehicle to move in ahead of another. It divides only where rounding could change the
    answer.

    Parameters
    ----------
    v : speed of the vehicle behind [m/s]. closing : its speed minus that of the vehicle that moves in [m/s].
    far : distance between them [m].
    """
    most, term = (IMPOSED + _MORE) * far, v * closing * _PER_TWICE_ROOT
    over = GAP + TIME * v + term - most
    band = _ROUNDING * (GAP + TIME * abs(v) + abs(term) + abs(most))
    if over > band or over < -band:
        return over < 0
    return desired_gap(v, closing) <= most


class _Extremes(NamedTuple):
    """Speeds [m/s] of each vehicle at each of the coming frames, and distances driven by then [m], each (K, m) or
    larger: `fast`, as fast as it may be; `slow`, as slow as it may be; `slowest`, as slow as any vehicle that moves
    forwards could be."""

    fast: FloatArray
    fast_way: FloatArray
    slow: FloatArray
    slow_way: FloatArray
    slowest: FloatArray
    slowest_way: FloatArray


@kernel_inline
def _surely_less(d: float, fast: float, slow: float, braking: float) -> bool:
    """Whether `_required_braking` is certainly less than `braking` [m/s^2], by more than the rounding error."""
    wanted = GAP + TIME * fast + fast * max(fast - slow, 0.0) * _PER_TWICE_ROOT
    return d > 1.0 and wanted * wanted < (braking - _SLACK) * _PER_SCALE * (d * d) * (1 - _ROUNDING)


class _Pair(NamedTuple):
    """A vehicle i and a vehicle j ahead of it.

    Attributes
    ----------
    ahead : distance from i to j [m]. near : the least distance, after what j may lose by turning [m].
    first : negative if j is in the lanes of i already; else the first frame at which it may move in.
    """

    i: int
    j: int
    ahead: float
    near: float
    first: int


@kernel_inline
def _raise_braking(pair: _Pair, x: _Extremes, motion: Motion, brakes: FloatArray, end: int) -> int:
    """Raise `brakes` (K,) of vehicle i of a pair to the braking that vehicle j may require.

    Parameters
    ----------
    x : extremes of all vehicles. end : number of frames before i may brake at `Motion.braking` anyway.

    Returns
    -------
    The number of frames before i may brake at `Motion.braking`, at most `end`.
    """
    i, j, ahead, near, first = pair.i, pair.j, pair.ahead, pair.near, pair.first
    back, begin = motion.loss_back * motion.dt, 0
    if first >= 0:
        begin = end
        for k in range(first, end):
            far, v = ahead + x.fast_way[k, j] - x.slowest_way[k, i], x.slowest[k, i]
            # MOBIL of a vehicle from beyond the next lane considers the vehicles in that lane now, not those that enter
            # it too.
            if far > 0 and (first > 0 or _permits_cut_in(v, v - x.fast[k, j], far)):
                begin = k
                break
    for k in range(begin, end):
        d = near + x.slow_way[k, j] - x.fast_way[k, i] - back * k
        if _surely_less(d, x.fast[k, i], x.slow[k, j], brakes[k]):
            continue  # another vehicle requires more
        rate = _required_braking(d, x.fast[k, i], x.slow[k, j], motion)
        brakes[k] = max(brakes[k], rate)
        if rate >= motion.braking:
            return k + 1
    return end


@kernel_no_refcount
def _extremes(
    others: FloatArray, states: FloatArray, stretch: FloatArray, motion: Motion, frames: int, ways: FloatArray
) -> None:
    """Fill in `frames` rows of `_Extremes`, the first six arrays of `ways` (see `hardest_braking`), as if each vehicle
    could brake at `Motion.braking` at once.

    The loops go over frames, then over vehicles, one quantity at a time and in contiguous rows, so that the compiler
    vectorises them.
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


@kernel_inline
def _fill(brakes: FloatArray, first: int, rate: float) -> None:
    """Let a vehicle brake at `rate` [m/s^2] from frame `first` on."""
    for k in range(first, brakes.shape[0]):
        brakes[k] = rate


@kernel_inline
def _greatest(numbers: FloatArray, m: int) -> float:
    """The greatest of the first m numbers, at least 0; inf if one is NaN."""
    greatest = 0.0
    for j in range(m):
        greatest = max(greatest, numbers[j]) if numbers[j] == numbers[j] else np.inf
    return greatest


@kernel_inline
def _first_frame_ahead(i: int, j: int, states: FloatArray, bodies: ReachableBodies, dt: float) -> int:
    """The first frame at which vehicle j may move in ahead of vehicle i; -1 if it is in the lanes of i already."""
    if not apart(bodies.first, bodies.last, bodies.low, bodies.high, i, j):
        return -1
    return max(int((abs(states[j, 1] - states[i, 1]) - _LANE) / (_TOWARDS * dt)), 0)


@kernel_no_refcount
def hardest_braking(
    vehicles: VehicleBodies, stretch: FloatArray, motion: Motion, place: LapPosition, work: ReactionWork
) -> None:
    """Fill in `brakes` of the bodies, the hardest braking of each vehicle at each coming frame.

    Parameters
    ----------
    stretch : least and greatest metres of s in a metre driven, (2, m); no columns on a straight road.
    """
    others, states, bodies = vehicles.rows, vehicles.states, vehicles.bodies
    lap, order, ways = place.lap, work.order, work.ways
    m, frames, last = states.shape[0], bodies.brakes.shape[1], bodies.brakes.shape[1] - 1
    curved, all_brakes, budget = stretch.shape[1] > 0, bodies.brakes, bodies.budget
    if not motion.comfortable_braking < motion.braking:
        for i in range(m):
            _fill(all_brakes[i], 0, motion.braking)
        return
    x, back = _Extremes(ways[0], ways[1], ways[2], ways[3], ways[4], ways[5]), motion.loss_back * motion.dt
    _extremes(others, states, stretch, motion, frames, ways)
    gets, slows, goes = x.fast_way[last], x.slow[last], x.slow_way[last]
    furthest = _greatest(gets, m)
    for n in range(m):
        i, end = order[n], frames
        behind, brakes = lap_distance(place.ego - states[i, 0], lap), all_brakes[i]
        if behind > 0 or others[i, _CRASHED] > 0:
            _fill(brakes, 0, motion.braking)
            continue
        _fill(brakes, 0, motion.comfortable_braking)
        least, most, fast = x.slowest_way[last, i], gets[i], x.fast[last, i]
        # The nearest first: once the vehicle may brake at `Motion.braking` at an earlier frame, fewer frames of the
        # others count.
        for other in range(m):
            j = order[n - 1 - other] if other < n else order[other]
            ahead = lap_distance(states[j, 0] - states[i, 0], lap)
            if other >= n and lap == 0 and ahead + furthest - least <= 0:
                break  # nor do vehicles further behind get ahead
            if i == j or not abs(ahead) <= _FAR:
                continue
            if ahead <= 0 and ahead + gets[j] - least <= 0:
                continue  # it does not get ahead
            # The distance is concave in time, so it is least at the first or the last frame. The desired gap grows.
            near, k = ahead - max(budget[j], 0.0), end - 1
            d = near + x.slow_way[k, j] - x.fast_way[k, i] - back * k
            if _surely_less(min(near, d), x.fast[k, i], x.slow[k, j], motion.comfortable_braking):
                continue  # it requires nothing before frame `end`
            d = near + goes[j] - most - back * last
            if not _requires_braking(min(near, d), fast, slows[j], motion):
                continue  # it requires nothing
            first = _first_frame_ahead(i, j, states, bodies, motion.dt)
            if first < end and (first >= 0 or ahead >= 0):
                end = _raise_braking(_Pair(i, j, ahead, near, first), x, motion, brakes, end)
                if end == 1 and brakes[0] >= motion.braking:
                    break
        _fill(brakes, end, motion.braking)
        # The vehicles behind take these speeds as those of their leader.
        v, shortest, longest = states[i, 3], stretch[0, i] if curved else 1.0, stretch[1, i] if curved else 1.0
        speeds, way = x.slow[:frames, i], x.slow_way[:frames, i]
        _slowest(v, min(v, -motion.reversing), brakes, (shortest, longest), motion.dt, speeds, way)
