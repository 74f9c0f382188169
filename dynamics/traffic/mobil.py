"""Who gains by a lane change: what highway-env's traffic asks before it begins one.

MOBIL lets a vehicle change lanes where that lets it accelerate more, and its new follower need not brake too hard. Both
are answered with the Intelligent Driver Model,

    a(v, leader) = a0 (1 - (v / v0)^4 - (d* / d)^2)        d* = d0 + T v + v (v - v_leader) / (2 sqrt(a b))

where d is the distance of centres. The speed v0 that a vehicle wants is not known, and drops out of the gain.

Sources: Treiber, Hennecke and Helbing 2000 (IDM); Kesting, Treiber and Helbing 2007 (MOBIL); the constants are those of
highway-env 1.12's `IDMVehicle`.
"""

from __future__ import annotations

import math

import numpy as np

from dynamics.compiled import compiled
from dynamics.state import BoolArray, FloatArray, IntArray

__all__ = ["COMFORT", "GAP", "IMPOSED", "TIME", "TWICE_ROOT", "desired_gap", "gains"]

GAP, TIME, TWICE_ROOT = 10.0, 1.5, 2.0 * math.sqrt(15.0)
"""IDM's d0 [m], T [s] and 2 sqrt(a b) [m/s^2]."""
IMPOSED = 1.3
"""Multiple of the distance that d* of a new follower may be: it would brake at no more than 2 m/s^2."""
COMFORT = 3.0
"""IDM's a0 [m/s^2]."""
_LEAST_GAIN = 0.2
"""Acceleration that a lane change has to gain [m/s^2]."""


@compiled
def desired_gap(v: float, closing: float) -> float:
    """IDM's desired gap d* at speed v, closing in on the vehicle ahead [m]; negative where it pulls away."""
    return GAP + TIME * v + v * closing / TWICE_ROOT


@compiled
def _held_up(v: float, closing: float, gap: float) -> float:
    """d* / d of a vehicle behind another."""
    return desired_gap(v, closing) / max(gap, 1e-2)


@compiled
def gains(
    states: FloatArray,
    lane: IntArray,
    low: FloatArray,
    high: FloatArray,
    centers: FloatArray,
    sight: float,
    slack: float,
) -> BoolArray:
    """Whether each vehicle would gain by a change into the lane below its own in r, and above, (m, 2) bool.

    Parameters
    ----------
    states : road states (m, 4). lane : the nearest lane of each, (m,). centers : of the lanes [m].
    low, high : edges of the lanes that each touches, (m,) [m]: whoever touches a vehicle's own may be its leader soon.
    sight : how near to a lane's centre a vehicle counts as being in it [m].
    slack : what the gain may lack [m/s^2]; and, as a share of the distance, what the new follower may.
    """
    m = states.shape[0]
    out = np.zeros((m, 2), np.bool_)
    for j in range(m):
        s, v = states[j, 0], states[j, 3]
        # Of the lanes below [0] and above [2]: distance and speed of the next ahead, and of the next behind.
        gaps, speeds, backs, behind = np.full(3, np.inf), np.zeros(3), np.full(3, np.inf), np.zeros(3)
        now, own = 0.0, centers[lane[j]]
        for i in range(m):
            ahead = states[i, 0] - s
            if i != j and ahead >= 0 and (abs(states[i, 1] - own) <= sight or low[i] < own < high[i]):
                now = max(now, _held_up(v, v - states[i, 3], ahead) ** 2)
            for k in (0, 2):
                to = lane[j] + k - 1
                if i == j or to < 0 or to >= centers.shape[0] or not abs(states[i, 1] - centers[to]) <= sight:
                    continue
                if 0 <= ahead < gaps[k]:
                    gaps[k], speeds[k] = ahead, states[i, 3]
                elif -backs[k] < ahead < 0:
                    backs[k], behind[k] = -ahead, states[i, 3]
        for k in (0, 2):
            to = lane[j] + k - 1
            if to < 0 or to >= centers.shape[0]:
                continue
            gain = COMFORT * (now - _held_up(v, v - speeds[k], gaps[k]) ** 2)
            imposed = _held_up(behind[k], behind[k] - v, backs[k])
            out[j, k // 2] = gain >= _LEAST_GAIN - slack and imposed <= IMPOSED + slack
    return out
