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

from typing import Any

import numpy as np

from dynamics.compiled import compiled
from dynamics.state import Vehicle
from dynamics.traffic.mobil import COMFORT, IMPOSED, desired_gap
from dynamics.traffic.occupancy_kernels import Bodies, Motion, apart

__all__ = ["brakings"]

_CRASHED = int(Vehicle.CRASHED)
_FAR = 150.0
"""What is further ahead asks for no braking beyond `Motion.calm` [m]."""
_SCALE, _SLACK = 1.1, 0.5
"""How much harder than IDM one may brake: as a share of it, and in addition [m/s^2]."""
_MORE = 0.2
"""By how much MOBIL's bound on what a lane change imposes may be exceeded, as a multiple of the distance."""
_LANE, _TOWARDS = 5.0, 14.0
"""Two that are further apart across the road than this [m] have to come nearer first, at this speed at most [m/s]."""


@compiled
def _fastest(v: float, motion: Motion, speeds: Any, ways: Any) -> None:
    """Greatest speed at each of the coming frames, `speeds` (K,) [m/s], and how far that has led by then, `ways`."""
    way, top = 0.0, max(v, motion.max_speed)
    for k in range(speeds.shape[0]):
        speeds[k], ways[k] = v, way
        way += v * motion.dt
        v = min(v + min(motion.acceleration, motion.power / max(v, 1e-3)) * motion.dt, top)


@compiled
def _slowest(v: float, brakes: Any, wrecked: bool, backwards: float, motion: Motion, speeds: Any, ways: Any) -> None:
    """Least speed at each of the coming frames of one that brakes at `brakes` (K,), down to `backwards` [m/s]."""
    way, dt = 0.0, motion.dt
    for k in range(speeds.shape[0]):
        speeds[k], ways[k] = v, way
        way += v * dt
        # highway-env: a crashed vehicle brakes at -1 * speed per second.
        v = max(min(v - brakes[k] * dt, v * (1 - dt) if wrecked else v), backwards)


@compiled
def _scale(ways: Any, least: float, greatest: float) -> None:
    """The least that ways (K,) may come to along the road [m], given metres of s in a metre driven."""
    for k in range(ways.shape[0]):
        ways[k] = min(ways[k] * least, ways[k] * greatest)


@compiled
def _asked(k: int, d: float, fast: Any, slow: Any, motion: Motion) -> float:
    """Braking at frame k for what is then at distance d ahead, and no faster than `slow` [m/s^2]."""
    if not d > 1.0:
        return motion.braking
    wanted = desired_gap(fast[k], max(fast[k] - slow[k], 0.0))
    return min(_SCALE * COMFORT * (wanted / d) ** 2 + _SLACK, motion.braking)


@compiled
def brakings(
    others: Any, states: Any, stretch: Any, motion: Motion, lap: float, ego: float, order: Any, bodies: Bodies
) -> None:
    """Fill in `brakes` from vehicle rows (m, 7), road states (m, 4), and the least and greatest metres of s in a metre
    driven, (2, m), or no columns on a straight road.

    Parameters
    ----------
    lap : length of a closed road, 0 of an open one [m].
    ego : where the ego is along the road [m]; whoever is behind it may have it to brake for. NaN without one.
    order : the vehicles from the first along the road to the last, (m,).
    """
    m, frames, dt, last = states.shape[0], bodies.brakes.shape[1], motion.dt, bodies.brakes.shape[1] - 1
    bodies.brakes[:], curved = motion.braking, stretch.shape[1] > 0
    if not motion.calm < motion.braking:
        return
    # As fast, and as slow, as each may be; the latter as its own bound says, once that is known.
    fast, fast_way = np.empty((m, frames)), np.empty((m, frames))
    slow, slow_way = np.empty((m, frames)), np.empty((m, frames))
    hard, hard_way = np.empty(frames), np.empty(frames)
    for i in range(m):
        wrecked = others[i, _CRASHED] > 0
        backwards = min(states[i, 3], 0.0 if wrecked else -motion.reversing)
        _fastest(max(states[i, 3], 0.0), motion, fast[i], fast_way[i])
        _slowest(states[i, 3], bodies.brakes[i], wrecked, backwards, motion, slow[i], slow_way[i])
        if curved:
            fast_way[i] *= stretch[1, i]
            _scale(slow_way[i], stretch[0, i], stretch[1, i])
    for n in range(m):
        i = order[n]
        behind, wrecked, brakes = ego - states[i, 0], others[i, _CRASHED] > 0, bodies.brakes[i]
        if lap > 0:
            behind -= lap * np.rint(behind / lap)
        if behind > 0 or wrecked:
            continue
        brakes[:] = motion.calm
        way, v = 0.0, max(states[i, 3], 0.0)
        for k in range(frames):
            hard[k], hard_way[k] = v, way * stretch[0, i] if curved else way
            way, v = way + v * dt, max(v - motion.braking * dt, 0.0)
        end = frames
        for p in range(m):
            j = order[p]
            ahead = states[j, 0] - states[i, 0]
            if lap > 0:
                ahead -= lap * np.rint(ahead / lap)
            if i == j or not abs(ahead) <= _FAR:
                continue
            near = ahead - max(bodies.budget[j], 0.0)
            if ahead <= 0 and ahead + fast_way[j, last] - hard_way[last] <= 0:
                continue  # it does not get ahead
            # The distance is least at one of its ends: it falls ever faster. What is wanted grows.
            d = min(near, near + slow_way[j, last] - fast_way[i, last] - motion.loss_back * dt * last)
            if not _asked(last, d, fast[i], slow[j], motion) > motion.calm:
                continue  # nor does it ask for anything
            entered, first = not apart(bodies, i, j), 0
            if entered and ahead < 0:
                continue
            if not entered:
                first = int((abs(states[j, 1] - states[i, 1]) - _LANE) / (_TOWARDS * dt))
            for k in range(end):
                if not entered and k >= first:
                    far = ahead + fast_way[j, k] - hard_way[k]
                    entered = far > 0 and desired_gap(hard[k], hard[k] - fast[j, k]) <= (IMPOSED + _MORE) * far
                if not entered:
                    continue
                d = near + slow_way[j, k] - fast_way[i, k] - motion.loss_back * dt * k
                rate = _asked(k, d, fast[i], slow[j], motion)
                brakes[k] = max(brakes[k], rate)
                if rate >= motion.braking:
                    end = k + 1
                    break
        brakes[end:] = motion.braking
        backwards = min(states[i, 3], -motion.reversing)
        _slowest(states[i, 3], brakes, False, backwards, motion, slow[i], slow_way[i])
        if curved:
            _scale(slow_way[i], stretch[0, i], stretch[1, i])
