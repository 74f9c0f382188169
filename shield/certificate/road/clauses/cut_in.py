"""Clause of cut-ins: vehicles alongside that change into the ego's lane, ahead of it or behind it, while the bodies
still overlap along the road.

MOBIL checks two conditions before a lane change: the new follower need not brake too hard, and the new leader restrains
the vehicle less than the old one does. Both use the Intelligent Driver Model's desired gap

    d* = d0 + T v + v (v - v_ahead) / (2 sqrt(a b))

to the *centre* of the other vehicle. If one vehicle pulls away from the other by some 15 m/s, d* vanishes. So a vehicle
that the ego passes changes into the ego's lane as soon as the ego's centre is ahead of its own. A vehicle that passes a
slow ego does so as soon as its centre is ahead of the ego's. Half a body length of each is still side by side then.
Between the centres of two lanes there is room for that; an ego that is off its lane's centre is hit.

Sources: Treiber, Hennecke and Helbing 2000 (IDM); Kesting, Treiber and Helbing 2007 (MOBIL); the constants are those of
highway-env 1.12's `IDMVehicle`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.state import FloatArray, IntArray
from dynamics.traffic.mobil import COMFORT, IMPOSED, TIME, TWICE_ROOT, desired_gap
from dynamics.traffic.tables import VehicleBodies
from dynamics.vehicle.rollout_kernels import StopTarget, roll_stop
from shield.certificate.road.clauses.footprint import Footprint
from shield.certificate.road.clauses.parameters import ClauseSettings

__all__ = [
    "CUT_IN_DURATION",
    "CutInBounds",
    "CutIns",
    "any_cut_in",
    "cut_in_separations",
    "cut_ins_of",
    "find_cut_ins",
    "sweeps",
]

_SLACK, _HARDLY = 3.0, 0.5
"""Tolerance on d* when the lane change starts [m]; the second is that for d* of the ego, since its plan is known."""
_DRIFT = 9.0
"""The same tolerance for each second of braking until then [m/s]."""
_CHANGES = 3.0
"""The same tolerance for each second, where the vehicle has to be restrained as it is now: its speed and its leader
change [m/s]."""
_COMING, _MOVES = 1.0, 0.3
"""A vehicle that approaches a lane faster than the second [m/s] counts as a leader there from the first further away
[m]."""
_OVERLAP = 2.0
"""Bodies nearer than this along the road may overlap, with the buffer between them [m]."""
_BRAKES = 1.0
"""Upper bound on the time for which a candidate for a cut-in and its leader have braked by then [s]."""
_NEAR = 60.0
"""Distance along the road beyond which vehicles are not considered [m]."""
CUT_IN_DURATION = 1.0
"""Time within which the vehicle has reached the other lane [s]."""
_CENTRED = 0.2
"""Distance from its lane's centre within which the ego counts as keeping its lane: a vehicle that cuts in has to leave
it the room [m]."""


class CutIns(NamedTuple):
    """Vehicles that may cut in.

    Attributes
    ----------
    starts : s of their centres, (m,) [m]. speeds : (m,) [m/s]. goals : centres of the lanes that they change into, (m,)
        [m].
    ratios : d* to the old leader as a share of the gap to it, in the worst case and now, (2, m).
    reaches : half the length of each, (m,) [m].
    gain, braking : greatest acceleration and greatest deceleration [m/s^2].
    sight : distance from a lane's centre within which the ego is visible there [m]. dt : frame [s].
    """

    starts: FloatArray
    speeds: FloatArray
    goals: FloatArray
    ratios: FloatArray
    reaches: FloatArray
    gain: float
    braking: float
    sight: float
    dt: float


class CutInBounds(NamedTuple):
    """Places that m vehicles can reach while they cut in.

    Attributes
    ----------
    rear, front : least and greatest s of each body after each frame, (m, at least K) [m].
    sweep : lateral extents of each body after each frame of its lane change, (m, T, 2) [m], see `sweeps`.
    """

    rear: FloatArray
    front: FloatArray
    sweep: FloatArray


@kernel_inline
def _blocked(v: float, speed: float, gap: float, braking: float) -> tuple[float, float]:
    """Ratio of d* to the gap to a leader: the greatest possible, and the present one."""
    closing = v - speed + braking * _BRAKES
    left = max(gap - _BRAKES * max(closing, 0.0), 1.0)
    return max(desired_gap(v, closing), 0.0) / left, max(desired_gap(v, v - speed), 0.0) / max(gap, 1.0)


@kernel_inline
def _held_up(j: int, states: FloatArray, center: float, sight: float, braking: float) -> tuple[float, float]:
    """The same for the vehicle that restrains vehicle `j` most in the lane with this centre [m]: the next one ahead in
    the lane, or one that is on its way there."""
    v, gap, speed, worst, now = states[j, 3], np.inf, 0.0, 0.0, 0.0
    for i in range(states.shape[0]):
        ahead, off = states[i, 0] - states[j, 0], states[i, 1] - center
        if i == j or not ahead >= 0:
            continue
        if abs(off) <= sight:
            if ahead < gap:
                gap, speed = ahead, states[i, 3]
        elif abs(off) <= sight + _COMING:
            across = states[i, 3] * math.sin(states[i, 2])
            if -math.copysign(across, off * across) > _MOVES:
                most, as_now = _blocked(v, states[i, 3], ahead, braking)
                worst, now = max(worst, most), max(now, as_now)
    if gap < np.inf:
        most, as_now = _blocked(v, speed, gap, braking)
        worst, now = max(worst, most), max(now, as_now)
    return worst, now


@kernel_no_refcount
def find_cut_ins(
    vehicles: VehicleBodies,
    ego: FloatArray,
    length: float,
    centers: FloatArray,
    sight: float,
    braking: float,
    out: FloatArray,
) -> int:
    """Find the vehicles that may cut into a lane in which the ego is visible, and return their number. Rows of `out`,
    (2 m, 4): vehicle, lane, greatest possible ratio of d* to the gap, and the present ratio."""
    others, states, bodies = vehicles.rows, vehicles.states, vehicles.bodies
    count, m, lane, first, last = 0, states.shape[0], bodies.lane, bodies.first, bodies.last
    for j in range(m):
        v, s = states[j, 3], states[j, 0]
        if first[j] > last[j] or not abs(s - ego[0]) <= _NEAR or others[j, 6] > 0 or not v >= 1.0:
            continue
        for side in (-1, 1):
            to = lane[j] + side
            if to < 0 or to >= centers.shape[0] or not abs(ego[1] - centers[to]) <= sight:
                continue
            if first[j] <= to <= last[j]:
                # Its band includes that lane already.
                continue
            # A vehicle changes lanes only if another one restrains it more than the ego would.
            worst, now = _held_up(j, states, centers[lane[j]], sight, braking)
            if not worst > 0:
                continue
            # Whether the change may begin while the bodies overlap, at any speed down to which the ego may brake.
            reach, fast = 0.5 * (others[j, 4] + length) + _OVERLAP, max(ego[3], 0.0) + 1.0
            u = min(max(0.5 * (v - TIME * TWICE_ROOT), 0.0), fast)
            most = worst * reach + _SLACK + _DRIFT * _BRAKES
            leads = desired_gap(v, v - fast) <= most
            most = IMPOSED * reach + _HARDLY + _DRIFT * _BRAKES
            if leads or desired_gap(u, u - v) <= most:
                out[count, 0], out[count, 1], out[count, 2], out[count, 3] = j, to, worst, now
                count += 1
    return count


@kernel_no_refcount
def cut_ins_of(
    found: FloatArray,
    vehicles: VehicleBodies,
    centers: FloatArray,
    settings: ClauseSettings,
    rows: IntArray,
    buffer: FloatArray,
) -> CutIns:
    """The tuple `CutIns` of the vehicles that `find_cut_ins` has found, (n, 4). Written: their `rows` (n,), and the
    `buffer` (6, n)."""
    states, reach, numbers, ratios = vehicles.states, vehicles.bodies.reach, buffer[:4], buffer[4:]
    for k in range(found.shape[0]):
        j = rows[k] = int(found[k, 0])
        numbers[0, k], numbers[1, k] = states[j, 0], states[j, 3]
        numbers[2, k], numbers[3, k] = centers[int(found[k, 1])], reach[j]
        ratios[0, k], ratios[1, k] = found[k, 2], found[k, 3]
    gain, braking, sight, dt = settings.acceleration, settings.hardest, settings.seen, settings.dt
    return CutIns(numbers[0], numbers[1], numbers[2], ratios, numbers[3], gain, braking, sight, dt)


@kernel_no_refcount
def sweeps(
    rows: IntArray,
    cut_ins: CutIns,
    vehicles: VehicleBodies,
    table: FloatArray,
    paths: FloatArray,
    out: FloatArray,
) -> None:
    """Lateral extents of each body after 1..T frames of its lane change, beginning with its present band; written to
    `out` (n, T, 2) [m].

    Parameters
    ----------
    rows : rows of the vehicles, (n,).
    table : of the road, see `dynamics.vehicle.rollout_kernels`.
    paths : buffer, (n, T, 4).
    """
    others, states, bodies = vehicles.rows, vehicles.states, vehicles.bodies
    frames = out.shape[1]
    for k in range(rows.shape[0]):
        j = rows[k]
        goal = cut_ins.goals[k]
        roll_stop(states[j], StopTarget(goal, goal, cut_ins.speeds[k], frames, 0.0), table, cut_ins.dt, paths[k])
        low, high, length, width = bodies.low[j], bodies.high[j], others[j, 4], others[j, 5]
        for f in range(frames):
            r, sin, cos = paths[k, f, 1], abs(math.sin(paths[k, f, 2])), abs(math.cos(paths[k, f, 2]))
            half = 0.5 * (length * sin + width * cos)
            low, high = min(low, r - half), max(high, r + half)
            out[k, f, 0], out[k, f, 1] = low, high


@kernel_inline
def _begins(s: float, r: float, u: float, k: int, j: int, cut_ins: CutIns) -> tuple[bool, bool, bool]:
    """Whether vehicle `j` may begin to cut in at frame k of a path; whether it may if it is restrained as it is now;
    and whether the ego is ahead of it.

    `s`, `r` and `u` are position [m] and speed [m/s] of the path at frame k.
    """
    v, t = cut_ins.speeds[j], cut_ins.dt * (k + 1)
    ahead = s - cut_ins.starts[j] - v * t
    seen = abs(r - cut_ins.goals[j]) <= cut_ins.sight
    if not ahead > 0:
        wanted = desired_gap(u, u - v)
        return seen and abs(wanted) <= _HARDLY - IMPOSED * ahead + _DRIFT * min(t, _BRAKES), False, False
    wanted = desired_gap(v, v - u)
    may = seen and abs(wanted) <= cut_ins.ratios[0, j] * ahead + _SLACK + _DRIFT * min(t, _BRAKES)
    # Until then it brakes behind its own leader, by IDM.
    slows = min(COMFORT * cut_ins.ratios[1, j] ** 2, cut_ins.braking)
    at_once = cut_ins.ratios[1, j] * (ahead + 0.5 * slows * t * t) + _HARDLY + _CHANGES * t
    slow = max(v - slows * t, 0.0)
    return may, seen and min(wanted, desired_gap(slow, slow - u)) <= at_once and wanted >= -at_once, True


@kernel_inline
def _offset(r: float, centers: FloatArray) -> float:
    """Distance from the nearest lane's centre [m]."""
    offset = np.inf
    for c in centers:
        offset = min(offset, abs(r - c))
    return offset


@kernel_no_refcount
def any_cut_in(path: FloatArray, cut_ins: CutIns, centers: FloatArray) -> bool:
    """Whether any vehicle may cut in where `cut_in_separations` considers it, or the path (K, 4) is not
    finite."""
    for j in range(cut_ins.goals.shape[0]):
        began = False
        for k in range(path.shape[0]):
            s, r, u = path[k, 0], path[k, 1], path[k, 3]
            if not math.isfinite(s + r + path[k, 2] + u):
                return True
            may, at_once, _ = _begins(s, r, u, k, j, cut_ins)
            began = began or may
            if began and (at_once or _offset(r, centers) > _CENTRED):
                return True
    return False


@kernel_no_refcount
def cut_in_separations(
    path: FloatArray,
    size: Footprint,
    cut_ins: CutIns,
    bounds: CutInBounds,
    centers: FloatArray,
    out: FloatArray,
) -> None:
    """Least separation of a path (K, 4) from each vehicle that cuts in, written to `out` (m,) [m]; +inf where it does
    not cut in.

    The first frame at which it may begin is the worst: later it reaches furthest. Once the bodies no longer overlap
    along the road, the vehicle has a distance obligation.
    """
    rear, front, sweep, dt = bounds.rear, bounds.front, bounds.sweep, cut_ins.dt
    lon, lat = size.along, size.across
    for j in range(cut_ins.goals.shape[0]):
        began, begun, leads, least = -1, -1, False, np.inf
        for k in range(path.shape[0]):
            s, r, psi, u = path[k, 0], path[k, 1], path[k, 2], path[k, 3]
            if not math.isfinite(s + r + psi + u):
                least = np.nan
                break
            if begun < 0:
                may, at_once, ahead_of = _begins(s, r, u, k, j, cut_ins)
                if began < 0 and may:
                    began, leads = k, ahead_of
                if at_once:
                    begun = k
            if began < 0:
                continue
            sin, cos = abs(math.sin(psi)), abs(math.cos(psi))
            half_s, half_r = lon * cos + lat * sin + size.growth_along, lon * sin + lat * cos + size.growth_across
            past = s - half_s - front[j, k] if leads else rear[j, k] - s - half_s
            if past >= 0 or k - began >= sweep.shape[1]:
                break
            offset, since = _offset(r, centers), k - began
            if offset <= _CENTRED:
                # Beside an ego that keeps to its lane's centre, the vehicle has to be restrained as it is now.
                if begun < 0:
                    continue
                since = k - begun
            across = max(sweep[j, since, 0] - r - half_r, r - half_r - sweep[j, since, 1])
            along = max(rear[j, k] - s - half_s, s - half_s - front[j, k])
            if offset <= _CENTRED:
                nose = cut_ins.starts[j] + cut_ins.speeds[j] * dt * (k + 1) + cut_ins.reaches[j]
                nose += 0.5 * cut_ins.gain * (since * dt) ** 2
                along = s - half_s - nose
            least = min(least, max(along, across))
        out[j] = least
