"""Who may come into a lane that the ego is about to enter, or has entered."""

from __future__ import annotations

import math

from dynamics.compiled import inlined, uncounted
from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.vehicle.controllers import KP_HEADING, KP_LATERAL
from shield.certificate.road.clauses.others import Others

__all__ = ["entrants", "is_beside", "joins", "leaves_sight", "neighbours", "sides_taken"]

_TURNING = 0.25
"""Speed across the road, beyond that of one that settles in its lane, from which a vehicle counts as changing [m/s]."""


@inlined
def is_beside(low: float, high: float, goal: float, width: float) -> bool:
    """Whether the strip from `low` to `high` ends less than a lane's `width` from a lane's centre, `goal` [m]."""
    return 0 < max(low - goal, goal - high) < width


@inlined
def leaves_sight(r: float, path: FloatArray, goal: float, sight: float) -> int:
    """The frame of a path (K, 4) of an ego at `r` across the road at which it gets out of sight again where it has been
    within `sight` of a lane's centre, `goal` [m]; K without one. Anybody beside that lane may come from then on."""
    seen = abs(r - goal) <= sight
    for k in range(path.shape[0]):
        if abs(path[k, 1] - goal) <= sight:
            seen = True
        elif seen:
            return k
    return path.shape[0]


@uncounted
def neighbours(
    others: Others,
    centers: FloatArray,
    width: float,
    before: BoolArray,
    visible: IntArray,
    plan: tuple[int, int],
    asked: BoolArray,
) -> None:
    """Fill in which lanes each vehicle's strip is beside, `others.beside`, and whether it matters if it gains by a
    change into the lane below its own, and above, `asked` (v, 2); the rest as in `entrants`."""
    low, high, lane, besides = others.low, others.high, others.lane, others.beside
    n, v = centers.shape[0], others.lane.shape[0]
    known = before.shape[0] == n and before.shape[1] == v
    for j in range(v):
        asked[j, 0] = asked[j, 1] = False
        for k in range(n):
            # Beside the lane: the next strip begins where this one ends.
            beside = is_beside(low[j], high[j], centers[k], width) and abs(centers[lane[j]] - centers[k]) < 1.5 * width
            besides[k, j] = beside
            if beside and not (known and (visible[k] > 0 or k == plan[0] or k == plan[1])):
                asked[j, 1 if centers[k] > high[j] else 0] = True


@uncounted
def entrants(
    others: Others,
    gains: BoolArray,
    centers: FloatArray,
    before: BoolArray,
    visible: IntArray,
    plan: tuple[int, int],
    sight: int,
    settled: int,
) -> None:
    """Fill in who may enter which lane, `others.comes`, of those whose strips are beside it, `others.beside`.

    Whoever gains by it may enter a lane, and who is on the way there: that is one who is faster across than one that
    settles in the middle of its own lane, the lag of its heading included. Where the ego has a plan to enter it, or
    is in sight there, whoever may enter when that begins may do so until `sight` frames after the ego has come into
    sight; those who were on their way by then, until it has been seen for `settled` frames. Nobody joins them.

    Parameters
    ----------
    others : the vehicles, (v,). gains : see `dynamics.traffic.mobil.gains`, (v, 2) bool; where `neighbours` asks.
    centers : of the lanes [m].
    before : `others.comes` of the scene before, (lanes, v); of another shape without one.
    visible : frames for which the ego has been visible in each lane, (lanes,).
    plan : the lane in which the stored plan stops, and the one that it enters on the way, or -1.
    """
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


@inlined
def sides_taken(
    lane: int,
    fail: int,
    rows: IntArray,
    others: Others,
    widths: FloatArray,
    centers: FloatArray,
    waver: float,
    low: FloatArray,
    high: FloatArray,
    home: IntArray,
) -> None:
    """Where each vehicle can be across the road, for a path: `low`, `high` (m,) [m], and its lane `home` (m,); until
    the path leaves the sight of a lane that it enters, see `joins`.

    Parameters
    ----------
    lane, fail : that it commits to, and stops in.
    rows : the vehicles, (m,). others : all of them, (v,), and the `widths` of their bodies [m].
    centers : of the lanes [m].
    waver : how far a body wavers that keeps to the middle of its lane [m].
    """
    lows, highs, lanes, comes = others.low, others.high, others.lane, others.comes
    for j in range(rows.shape[0]):
        row = rows[j]
        low[j], high[j], home[j] = lows[row], highs[row], lanes[row]
    for step in range(2 if fail != lane else 1):
        entered = lane if step == 0 else fail
        goal = centers[entered]
        for j in range(rows.shape[0]):
            row = rows[j]
            if max(lows[row] - goal, goal - highs[row]) <= 0:
                home[j] = entered  # it is there already, and sees the ego there
            if not comes[entered, row] or not math.isfinite(low[j] + high[j]):
                continue
            # As far as the strip of one that is on its way to the middle of that lane.
            core = 0.5 * widths[row] + waver
            low[j], high[j] = min(low[j], goal - core), max(high[j], goal + core)
            home[j] = entered


@inlined
def joins(low: float, high: float, goal: float, core: float, width: float) -> tuple[float, float]:
    """Where a vehicle with the strip from `low` to `high` can be once the ego has got out of sight in the lane with the
    centre `goal` [m]: there too, as far as its `core` around the middle, if the strip is beside it. `width`: of a lane.
    """
    if is_beside(low, high, goal, width):
        return min(low, goal - core), max(high, goal + core)
    return low, high
