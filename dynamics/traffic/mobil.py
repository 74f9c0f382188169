"""Lane-change incentive by MOBIL, as highway-env's traffic computes it before a lane change.

MOBIL permits a lane change that increases the vehicle's own acceleration, unless the new follower has to brake too
hard. Both accelerations come from the Intelligent Driver Model,

    a(v, leader) = a0 (1 - (v / v0)^4 - (d* / d)^2)        d* = d0 + T v + v (v - v_leader) / (2 sqrt(a b))

where d is the distance of centres. The desired speed v0 is not known, and cancels in the incentive.

Sources: Treiber, Hennecke and Helbing 2000 (IDM); Kesting, Treiber and Helbing 2007 (MOBIL); the constants are those of
highway-env 1.12's `IDMVehicle`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.state import BoolArray, FloatArray, IntArray

__all__ = [
    "COMFORT",
    "GAP",
    "IMPOSED",
    "LEAST_GAIN",
    "TIME",
    "TWICE_ROOT",
    "LaneSight",
    "TrafficInLanes",
    "desired_gap",
    "desired_gap_with",
    "lane_change_incentive",
    "lane_change_incentives",
]

GAP, TIME, TWICE_ROOT = 10.0, 1.5, 2.0 * math.sqrt(15.0)
"""IDM's d0 [m], T [s] and 2 sqrt(a b) [m/s^2]."""
IMPOSED = 1.3
"""Greatest ratio d* / d of the new follower: it brakes at no more than 2 m/s^2."""
COMFORT = 3.0
"""IDM's a0 [m/s^2]."""
_LEAVES = 1.0
"""Time for which the lateral motion is extrapolated: a vehicle outside a lane after it does not count as in the lane
[s]."""
LEAST_GAIN = 0.2
"""Least gain in acceleration of a lane change [m/s^2]."""


class TrafficInLanes(NamedTuple):
    """m vehicles and their lanes.

    Attributes
    ----------
    states : road states (m, 4).
    across : lateral speed of each vehicle, (m,) [m/s].
    lane : nearest lane of each vehicle, (m,).
    low, high : edges of the lanes that each vehicle touches, (m,) [m]. A vehicle that touches the centre of another's
        lane may soon be its leader.
    """

    states: FloatArray
    across: FloatArray
    lane: IntArray
    low: FloatArray
    high: FloatArray


class LaneSight(NamedTuple):
    """Lanes, and when a lane change into them is an incentive.

    Attributes
    ----------
    centers : of the lanes, (lanes,) [m].
    sight : greatest distance from a lane's centre at which a vehicle counts as in the lane [m].
    slack : by how much the gain may fall short [m/s^2]; and by how much d* / d of the new follower may exceed its
        bound.
    """

    centers: FloatArray
    sight: float
    slack: float


@kernel_inline
def desired_gap_with(distance: float, time: float, twice_root: float, v: float, closing: float) -> float:
    """IDM's desired gap d* to the leader [m], by a driver's d0 [m], T [s] and 2 sqrt(a b) [m/s^2].

    Parameters
    ----------
    v : speed [m/s].
    closing : speed minus the leader's speed [m/s]. Where it is very negative, so is the gap.
    """
    return distance + v * time + v * closing / twice_root


@kernel_inline
def desired_gap(v: float, closing: float) -> float:
    """IDM's desired gap d* [m], by the constants of `IDMVehicle`, at speed `v` and closing speed `closing` [m/s]."""
    return desired_gap_with(GAP, TIME, TWICE_ROOT, v, closing)


@kernel_inline
def _gap_ratio(v: float, closing: float, gap: float) -> float:
    """Ratio d* / d of a vehicle to its leader, at a distance of centres `gap` [m]."""
    return desired_gap(v, closing) / max(gap, 1e-2)


@kernel_inline
def _mobil_permits(v: float, now: float, gap: float, speed: float, back: float, behind: float, slack: float) -> bool:
    """Whether MOBIL permits a lane change.

    Parameters
    ----------
    v : speed of the vehicle [m/s]. now : (d* / d)^2 to the old leader.
    gap, speed : distance [m] and speed [m/s] of the new leader.
    back, behind : distance [m] and speed [m/s] of the new follower.
    slack : as in `LaneSight`.
    """
    gain = COMFORT * (now - _gap_ratio(v, v - speed, gap) ** 2)
    imposed = _gap_ratio(behind, behind - v, back)
    return gain >= LEAST_GAIN - slack and imposed <= IMPOSED + slack


@kernel_inline
def _counts_in_lane(r: float, across: float, center: float, sight: float) -> bool:
    """Whether a vehicle at r [m], with lateral speed `across` [m/s], counts as in a lane: now, and after `_LEAVES`
    seconds."""
    return abs(r - center) <= sight and abs(r + _LEAVES * across - center) <= sight


@kernel_inline
def lane_change_incentive(
    j: int, traffic: TrafficInLanes, lanes: LaneSight, ego: FloatArray, requested: BoolArray, out: BoolArray
) -> None:
    """Whether vehicle `j` would gain by a change into the lane below its own in r, and into the one above, `out` (2,),
    written. Only lanes `requested` for (2,) are computed; the others are False. The other parameters are those of
    `lane_change_incentives`."""
    states, across, lane, low, high = traffic.states, traffic.across, traffic.lane, traffic.low, traffic.high
    centers, sight, slack = lanes.centers, lanes.sight, lanes.slack
    s, v, own = states[j, 0], states[j, 3], centers[lane[j]]
    now, ahead = 0.0, ego[0] - s
    if ahead >= 0 and (abs(ego[1] - own) <= sight or low[j] < ego[1] < high[j]):
        now = _gap_ratio(v, v - ego[3], ahead) ** 2
    # Of the lanes below and above: distance and speed of the next vehicle ahead, and of the next behind.
    gap0, gap1, back0, back1 = np.inf, np.inf, np.inf, np.inf
    speed0, speed1, behind0, behind1 = 0.0, 0.0, 0.0, 0.0
    below, above = requested[0] and lane[j] > 0, requested[1] and lane[j] + 1 < centers.shape[0]
    low0, high1 = centers[lane[j] - 1] if below else np.nan, centers[lane[j] + 1] if above else np.nan
    for i in range(states.shape[0]):
        if i == j:
            continue
        ahead, r = states[i, 0] - s, states[i, 1]
        if ahead >= 0 and (abs(r - own) <= sight or low[i] < own < high[i]):
            now = max(now, _gap_ratio(v, v - states[i, 3], ahead) ** 2)
        if _counts_in_lane(r, across[i], low0, sight):
            if 0 <= ahead < gap0:
                gap0, speed0 = ahead, states[i, 3]
            elif -back0 < ahead < 0:
                back0, behind0 = -ahead, states[i, 3]
        if _counts_in_lane(r, across[i], high1, sight):
            if 0 <= ahead < gap1:
                gap1, speed1 = ahead, states[i, 3]
            elif -back1 < ahead < 0:
                back1, behind1 = -ahead, states[i, 3]
    out[0] = below and _mobil_permits(v, now, gap0, speed0, back0, behind0, slack)
    out[1] = above and _mobil_permits(v, now, gap1, speed1, back1, behind1, slack)


@kernel_no_refcount
def lane_change_incentives(
    traffic: TrafficInLanes, lanes: LaneSight, ego: FloatArray, requested: BoolArray, out: BoolArray
) -> None:
    """Whether each vehicle would gain by a change into the lane below its own in r, and into the one above, `out` (m,
    2), written.

    Parameters
    ----------
    ego : road state (4,) of the ego. It counts as a leader in the old lane, but not as a vehicle in the new one: the
        others do not see it there.
    requested : which lane changes to compute, (m, 2); the others are False in `out`.
    """
    for j in range(traffic.states.shape[0]):
        out[j, 0] = out[j, 1] = False
        if requested[j, 0] or requested[j, 1]:
            lane_change_incentive(j, traffic, lanes, ego, requested[j], out[j])
