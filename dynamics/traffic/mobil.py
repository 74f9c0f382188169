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

from dynamics.compiled import inlined, uncounted
from dynamics.state import BoolArray, FloatArray, IntArray

__all__ = ["COMFORT", "GAP", "IMPOSED", "LEAST_GAIN", "TIME", "TWICE_ROOT", "desired_gap", "gain_of", "gains", "gap_by"]

GAP, TIME, TWICE_ROOT = 10.0, 1.5, 2.0 * math.sqrt(15.0)
"""IDM's d0 [m], T [s] and 2 sqrt(a b) [m/s^2]."""
IMPOSED = 1.3
"""Multiple of the distance that d* of a new follower may be: it would brake at no more than 2 m/s^2."""
COMFORT = 3.0
"""IDM's a0 [m/s^2]."""
_LEAVES = 1.0
"""Who is out of a lane after so long as it is going now does not count there any more [s]."""
LEAST_GAIN = 0.2
"""Acceleration that a lane change has to gain [m/s^2]."""


@inlined
def gap_by(distance: float, time: float, twice_root: float, v: float, closing: float) -> float:
    """IDM's desired gap d* by a driver's own d0 [m], T [s] and 2 sqrt(a b) [m/s^2], at speed v, closing in on the
    vehicle ahead [m]; negative where it pulls away."""
    return distance + v * time + v * closing / twice_root


@inlined
def desired_gap(v: float, closing: float) -> float:
    """The same by the constants of `IDMVehicle`."""
    return gap_by(GAP, TIME, TWICE_ROOT, v, closing)


@inlined
def _held_up(v: float, closing: float, gap: float) -> float:
    """d* / d of a vehicle behind another."""
    return desired_gap(v, closing) / max(gap, 1e-2)


@inlined
def _pays(v: float, now: float, gap: float, speed: float, back: float, behind: float, slack: float) -> bool:
    """MOBIL's answer: `now` is (d* / d)^2 of the old leader, the new one is at `gap` and `speed`, the new follower at
    `back` and `behind`."""
    gain = COMFORT * (now - _held_up(v, v - speed, gap) ** 2)
    imposed = _held_up(behind, behind - v, back)
    return gain >= LEAST_GAIN - slack and imposed <= IMPOSED + slack


@inlined
def _stays(r: float, across: float, center: float, sight: float) -> bool:
    """Whether a vehicle counts in a lane: one that is leaving it is nobody's leader there by the time that somebody
    enters it."""
    return abs(r - center) <= sight and abs(r + _LEAVES * across - center) <= sight


@inlined
def gain_of(
    j: int,
    states: FloatArray,
    across: FloatArray,
    lane: IntArray,
    low: FloatArray,
    high: FloatArray,
    centers: FloatArray,
    sight: float,
    slack: float,
    ego: FloatArray,
    asked: BoolArray,
    out: BoolArray,
) -> None:
    """Whether vehicle `j` would gain by a change into the lane below its own in r, and above, `out` (2,), where that is
    `asked` (2,); see `gains`."""
    s, v, own = states[j, 0], states[j, 3], centers[lane[j]]
    now, ahead = 0.0, ego[0] - s
    if ahead >= 0 and (abs(ego[1] - own) <= sight or low[j] < ego[1] < high[j]):
        now = _held_up(v, v - ego[3], ahead) ** 2
    # Of the lanes below and above: distance and speed of the next ahead, and of the next behind.
    gap0, gap1, back0, back1 = np.inf, np.inf, np.inf, np.inf
    speed0, speed1, behind0, behind1 = 0.0, 0.0, 0.0, 0.0
    below, above = asked[0] and lane[j] > 0, asked[1] and lane[j] + 1 < centers.shape[0]
    low0, high1 = centers[lane[j] - 1] if below else np.nan, centers[lane[j] + 1] if above else np.nan
    for i in range(states.shape[0]):
        if i == j:
            continue
        ahead, r = states[i, 0] - s, states[i, 1]
        if ahead >= 0 and (abs(r - own) <= sight or low[i] < own < high[i]):
            now = max(now, _held_up(v, v - states[i, 3], ahead) ** 2)
        if _stays(r, across[i], low0, sight):
            if 0 <= ahead < gap0:
                gap0, speed0 = ahead, states[i, 3]
            elif -back0 < ahead < 0:
                back0, behind0 = -ahead, states[i, 3]
        if _stays(r, across[i], high1, sight):
            if 0 <= ahead < gap1:
                gap1, speed1 = ahead, states[i, 3]
            elif -back1 < ahead < 0:
                back1, behind1 = -ahead, states[i, 3]
    out[0] = below and _pays(v, now, gap0, speed0, back0, behind0, slack)
    out[1] = above and _pays(v, now, gap1, speed1, back1, behind1, slack)


@uncounted
def gains(
    states: FloatArray,
    across: FloatArray,
    lane: IntArray,
    low: FloatArray,
    high: FloatArray,
    centers: FloatArray,
    sight: float,
    slack: float,
    ego: FloatArray,
    asked: BoolArray,
    out: BoolArray,
) -> None:
    """Whether each vehicle would gain by a change into the lane below its own in r, and above, `out` (m, 2), where that
    is `asked` (m, 2): False elsewhere.

    Parameters
    ----------
    states : road states (m, 4). across : speed of each across the road, (m,) [m/s].
    lane : the nearest lane of each, (m,). centers : of the lanes [m].
    low, high : edges of the lanes that each touches, (m,) [m]: whoever touches a vehicle's own may be its leader soon.
    sight : how near to a lane's centre a vehicle counts as being in it [m].
    slack : what the gain may lack [m/s^2]; and, as a share of the distance, what the new follower may.
    ego : road state of one more, (4,), that holds others up and is in nobody's way where they want to go: they do not
        see it there.
    """
    for j in range(states.shape[0]):
        out[j, 0] = out[j, 1] = False
        if asked[j, 0] or asked[j, 1]:
            gain_of(j, states, across, lane, low, high, centers, sight, slack, ego, asked[j], out[j])
