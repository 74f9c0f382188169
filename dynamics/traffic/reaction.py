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
def _faster(v: float, motion: Motion) -> float:
    """Speed after a frame at the greatest acceleration [m/s]."""
    return min(v + min(motion.acceleration, motion.power / max(v, 1e-3)) * motion.dt, max(v, motion.max_speed))


@compiled
def _press(
    i: int, j: int, ahead: float, hardest: Any, wrecked: bool, states: Any, motion: Motion, bodies: Bodies, end: int
) -> int:
    """Raise `bodies.brakes` of vehicle i to what vehicle j, `ahead` [m] of it, may ask for, braking at `hardest` (K,)
    itself; the number of frames before i may brake as hard as can be, `end` at most."""
    dt, brakes = motion.dt, bodies.brakes[i]
    entered, first = not apart(bodies, i, j), 0
    if not entered:
        first = int((abs(states[j, 1] - states[i, 1]) - _LANE) / (_TOWARDS * dt))
    elif ahead < 0:
        return end
    # The extremes: i as fast and j as slow and as near as can be; and the other way round.
    v, u, d = max(states[i, 3], 0.0), states[j, 3], ahead - max(bodies.budget[j], 0.0)
    slow, fast, far, backwards = v, u, ahead, min(u, 0.0 if wrecked else -motion.reversing)
    for k in range(end):
        if not entered and k >= first:
            entered = far > 0 and desired_gap(slow, slow - fast) <= (IMPOSED + _MORE) * far
        if entered:
            rate = motion.braking
            if d > 1.0:
                rate = min(_SCALE * COMFORT * (desired_gap(v, max(v - u, 0.0)) / d) ** 2 + _SLACK, rate)
            brakes[k] = max(brakes[k], rate)
            if rate >= motion.braking:
                return k + 1
        d, far = d + (u - v - motion.loss_back) * dt, far + (fast - slow) * dt
        # highway-env: a crashed vehicle brakes at -1 * speed per second.
        u = max(min(u - hardest[k] * dt, u * (1 - dt) if wrecked else u), backwards)
        v, fast, slow = _faster(v, motion), _faster(fast, motion), max(slow - motion.braking * dt, 0.0)
    return end


@compiled
def brakings(others: Any, states: Any, motion: Motion, lap: float, ego: float, order: Any, bodies: Bodies) -> None:
    """Fill in `brakes` from vehicle rows (m, 7) and road states (m, 4).

    Parameters
    ----------
    lap : length of a closed road, 0 of an open one [m].
    ego : where the ego is along the road [m]; whoever is behind it may have it to brake for. NaN without one.
    order : the vehicles from the first along the road to the last, (m,).
    """
    m, frames = states.shape[0], bodies.brakes.shape[1]
    worst = np.full(frames, motion.braking)
    for n in range(m):
        i = order[n]
        behind = ego - states[i, 0]
        if lap > 0:
            behind -= lap * np.rint(behind / lap)
        if behind > 0 or others[i, _CRASHED] > 0 or not motion.calm < motion.braking:
            bodies.brakes[i] = motion.braking
            continue
        bodies.brakes[i] = motion.calm
        end = frames
        for p in range(m):
            j = order[p]
            ahead = states[j, 0] - states[i, 0]
            if lap > 0:
                ahead -= lap * np.rint(ahead / lap)
            if i != j and abs(ahead) <= _FAR:
                hardest = bodies.brakes[j] if p < n else worst
                end = _press(i, j, ahead, hardest, others[j, _CRASHED] > 0, states, motion, bodies, end)
        bodies.brakes[i, end:] = motion.braking
