"""Vehicles that may enter a lane that the ego is about to enter, or has entered."""

from __future__ import annotations

import math
from typing import NamedTuple

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.vehicle.controllers import KP_HEADING, KP_LATERAL
from shield.certificate.road.clauses.clause_inputs import LaneState
from shield.certificate.road.clauses.others import RoadVehicles

__all__ = ["LateralExtents", "is_beside", "joins", "lateral_extents", "leaves_sight", "mark_entrants", "neighbours"]

_TURNING = 0.25
"""Lateral speed from which a vehicle counts as changing lanes, beyond the lateral speed of one that settles in its lane
[m/s]."""


class LateralExtents(NamedTuple):
    """Lateral extents of m vehicles for a path, `low` and `high` (m,) [m], and their lanes, `home` (m,)."""

    low: FloatArray
    high: FloatArray
    home: IntArray


@kernel_inline
def is_beside(low: float, high: float, goal: float, width: float) -> bool:
    """Whether the band from `low` to `high` ends less than a lane's `width` from a lane's centre, `goal` [m]."""
    return 0 < max(low - goal, goal - high) < width


@kernel_inline
def leaves_sight(r: float, path: FloatArray, goal: float, sight: float) -> int:
    """First frame of a path (K, 4) in which the ego is no longer visible in a lane where it has been; K if there is
    none. From then on, any vehicle beside that lane may enter it.

    `r` is the lateral position of the ego now, `goal` the lane's centre, and `sight` the distance within which the ego
    is visible [m].
    """
    seen = abs(r - goal) <= sight
    for k in range(path.shape[0]):
        if abs(path[k, 1] - goal) <= sight:
            seen = True
        elif seen:
            return k
    return path.shape[0]


@kernel_no_refcount
def neighbours(
    others: RoadVehicles,
    centers: FloatArray,
    width: float,
    before: BoolArray,
    visible: IntArray,
    plan: tuple[int, int],
    requested: BoolArray,
) -> None:
    """For each vehicle, fill in `others.beside`, the lanes beside its band; and `requested`, (v, 2), whether it
    matters if it gains by a change into the lane below its own, and above. The rest as in `mark_entrants`."""
    low, high, lane, besides = others.low, others.high, others.lane, others.beside
    n, v = centers.shape[0], others.lane.shape[0]
    known = before.shape[0] == n and before.shape[1] == v
    for j in range(v):
        requested[j, 0] = requested[j, 1] = False
        for k in range(n):
            # Beside the lane: the next band begins where this one ends.
            beside = is_beside(low[j], high[j], centers[k], width) and abs(centers[lane[j]] - centers[k]) < 1.5 * width
            besides[k, j] = beside
            if beside and not (known and (visible[k] > 0 or k == plan[0] or k == plan[1])):
                requested[j, 1 if centers[k] > high[j] else 0] = True


@kernel_no_refcount
def mark_entrants(
    others: RoadVehicles,
    gains: BoolArray,
    lanes: LaneState,
    before: BoolArray,
    plan: tuple[int, int],
    sight: int,
    settled: int,
) -> None:
    """Fill in `others.comes`: which lanes each vehicle may enter, of those beside its band (`others.beside`).

    A vehicle may enter a lane if it gains by that, or is on its way there. It is on its way if it moves sideways faster
    than a vehicle that settles in its own lane's centre, with the lag of its heading. The ego may have a plan to enter
    the lane, or be visible there. Then only vehicles that might enter at that time may still do so. Any of them may
    until the ego has been visible for `sight` frames; those on their way may until it has been visible for `settled`
    frames.

    Parameters
    ----------
    others : the vehicles, (v,).
    gains : see `dynamics.traffic.mobil.lane_change_incentives`, (v, 2) bool; valid where `neighbours` has set
        `requested`.
    lanes : of the scene.
    before : `others.comes` of the scene before, (lanes, v); of another shape if there was none.
    plan : lane in which the stored plan stops, and lane that it enters on the way, or -1.
    sight, settled : numbers of frames, see `VisibilityParameters.reaction` and `VisibilityParameters.settled`.
    """
    centers, visible = lanes.centers, lanes.visible
    high, lane, r, across = others.high, others.lane, others.r, others.across
    besides, comes, n, v = others.beside, others.comes, centers.shape[0], others.lane.shape[0]
    known = before.shape[0] == n and before.shape[1] == v
    for k in range(n):
        for j in range(v):
            beside, may, turning = besides[k, j], False, False
            if beside:
                above = centers[k] > high[j]
                sign = 1.0 if above else -1.0
                toward, left = sign * across[j], sign * (centers[lane[j]] - r[j])
                turning = toward > KP_LATERAL * (left + toward / KP_HEADING) + _TURNING
                may = turning or gains[j, 1 if above else 0]
            last = before[k, j] if known else may
            if visible[k] >= settled:
                may = False
            elif visible[k] > sight:
                may = last and turning
            elif visible[k] > 0 or k == plan[0] or k == plan[1]:
                may = last and beside
            comes[k, j] = may


@kernel_inline
def lateral_extents(
    entered: tuple[int, int],
    rows: IntArray,
    others: RoadVehicles,
    widths: FloatArray,
    centers: FloatArray,
    lateral_deviation: float,
    out: LateralExtents,
) -> None:
    """Write the lateral extents of each vehicle for a path, and its lane, to `out`. They hold until the ego is no
    longer visible in a lane that it enters, see `joins`.

    Parameters
    ----------
    entered : lanes that the path commits to and stops in.
    rows : rows of the vehicles, (m,). others : all vehicles, (v,). widths : of their bodies, (v,) [m].
    centers : of the lanes [m].
    lateral_deviation : greatest lateral deviation of a body from its lane's centre while it keeps to the centre [m].
    """
    lane, fail, low, high, home = entered[0], entered[1], out.low, out.high, out.home
    lows, highs, lanes, comes = others.low, others.high, others.lane, others.comes
    for j in range(rows.shape[0]):
        row = rows[j]
        low[j], high[j], home[j] = lows[row], highs[row], lanes[row]
    for step in range(2 if fail != lane else 1):
        to = lane if step == 0 else fail
        goal = centers[to]
        for j in range(rows.shape[0]):
            row = rows[j]
            if max(lows[row] - goal, goal - highs[row]) <= 0:
                home[j] = to  # it is there already, and sees the ego there
            if not comes[to, row] or not math.isfinite(low[j] + high[j]):
                continue
            # As far as the band of a vehicle that is on its way to the centre of that lane.
            core = 0.5 * widths[row] + lateral_deviation
            low[j], high[j] = min(low[j], goal - core), max(high[j], goal + core)
            home[j] = to


@kernel_inline
def joins(low: float, high: float, goal: float, core: float, width: float) -> tuple[float, float]:
    """Lateral extents of a vehicle with the band from `low` to `high` [m], once the ego is no longer visible in the
    lane with the centre `goal`. If the band is beside that lane, the vehicle may be there too, within `core` of its
    centre. `width` is that of a lane."""
    if is_beside(low, high, goal, width):
        return min(low, goal - core), max(high, goal + core)
    return low, high
