"""Who may come into a lane that the ego is about to enter, or has entered."""

from __future__ import annotations

import math

import numpy as np

from dynamics.compiled import inlined, uncounted
from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.vehicle.controllers import KP_HEADING, KP_LATERAL
from shield.certificate.clauses.others import Others

__all__ = ["entrants", "neighbours", "sides_taken"]

_TURNING = 0.25
"""Speed across the road, beyond that of one that settles in its lane, from which a vehicle counts as changing [m/s]."""


@uncounted
def neighbours(
    others: Others,
    centers: FloatArray,
    width: float,
    before: BoolArray,
    visible: IntArray,
    stored: int,
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
            apart = max(low[j] - centers[k], centers[k] - high[j])
            beside = 0 < apart < width and abs(centers[lane[j]] - centers[k]) < 1.5 * width
            besides[k, j] = beside
            if beside and not (known and (visible[k] > 0 or k == stored)):
                asked[j, 1 if centers[k] > high[j] else 0] = True


@uncounted
def entrants(
    others: Others,
    gains: BoolArray,
    centers: FloatArray,
    before: BoolArray,
    visible: IntArray,
    stored: int,
    sight: int,
    settled: int,
) -> None:
    """Fill in who may enter which lane, `others.comes`, of those whose strips are beside it, `others.beside`.

    Whoever gains by it may enter a lane, and who is on the way there: that is one who is faster across than one that
    settles in the middle of its own lane, the lag of its heading included. Where the ego has a plan to stop there, or
    is in sight there, whoever may enter when that begins may do so until `sight` frames after the ego has come into
    sight; those who were on their way by then, until it has been seen for `settled` frames. Nobody joins them.

    Parameters
    ----------
    others : the vehicles, (v,). gains : see `dynamics.traffic.mobil.gains`, (v, 2) bool; where `neighbours` asks.
    centers : of the lanes [m].
    before : `others.comes` of the scene before, (lanes, v); of another shape without one.
    visible : frames for which the ego has been visible in each lane, (lanes,).
    stored : the lane in which the stored fail-safe stops, or -1.
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
            elif visible[k] > 0 or k == stored:
                may = last and beside
            comes[k, j] = may


@inlined
def sides_taken(
    path: FloatArray,
    lane: int,
    fail: int,
    rows: IntArray,
    others: Others,
    centers: FloatArray,
    settings: tuple[float, float, float, float],
    low: FloatArray,
    high: FloatArray,
    home: IntArray,
) -> None:
    """Where each vehicle can be across the road, for a path: `low`, `high` (m,) [m], and its lane `home` (m,).

    Parameters
    ----------
    path, lane, fail : (K, 4), and the lane that it commits to, and stops in.
    rows : the vehicles, (m,). others : all of them, (v,).
    centers : of the lanes [m].
    settings : the ego's lateral position now, the distance within which it is seen, the width of a lane, and how far a
        body may lean over a marking, (4,) [m].
    """
    lows, highs, lanes, comes, beside = others.low, others.high, others.lane, others.comes, others.beside
    r, sight, width, lean = settings[0], settings[1], settings[2], settings[3]
    least, most = np.inf, -np.inf
    for k in range(path.shape[0]):
        least, most = min(least, path[k, 1]), max(most, path[k, 1])
    for j in range(rows.shape[0]):
        row = rows[j]
        low[j], high[j], home[j] = lows[row], highs[row], lanes[row]
    for step in range(2 if fail != lane else 1):
        entered = lane if step == 0 else fail
        goal = centers[entered]
        # Once the ego is out of sight there, anybody may come.
        leaves = abs(r - goal) <= sight < max(abs(least - goal), abs(most - goal))
        for j in range(rows.shape[0]):
            row = rows[j]
            if max(lows[row] - goal, goal - highs[row]) <= 0:
                home[j] = entered  # it is there already, and sees the ego there
            enters = comes[entered, row] or (leaves and beside[entered, row])
            if not enters or not math.isfinite(low[j] + high[j]):
                continue
            low[j] = min(low[j], goal - 0.5 * width - lean)
            high[j] = max(high[j], goal + 0.5 * width + lean)
            home[j] = entered
