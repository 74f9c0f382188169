"""Who owes the ego its distance, and which lanes are its own: of whom a plan has to stay clear."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import compiled
from dynamics.state import BoolArray, FloatArray, IntArray, Vehicle
from dynamics.traffic.mobil import gains
from dynamics.traffic.permits import Ego, gap_between
from dynamics.traffic.tables import Bodies
from shield.certificate.clauses.entering import newcomers, still_coming
from shield.certificate.clauses.footprint import Footprint, reach_across, reach_along
from shield.certificate.clauses.others import TOUCH, Others

__all__ = ["Sight", "Standing", "in_reach", "lanes_held", "others_of", "threats"]

_LENGTH, _WIDTH = int(Vehicle.LENGTH), int(Vehicle.WIDTH)
_LONG = 10**6
"""Frames that stand for as long as one likes."""
_CORNER = 0.5
"""How far a corner of a vehicle behind may come beside a corner of the ego's buffer [m]."""


class Sight(NamedTuple):
    """What decides about who sees whom.

    `distance`: from a lane's centre within which a vehicle is seen there [m]; `slack` [m/s^2]: on what one gains that
    enters a lane; `reaction`, `settled`: frames for which the ego has been in sight after which nobody begins to enter,
    and nobody enters any more; `blind`: whether anybody enters a lane that the ego is about to; `width`: of a lane [m].
    """

    distance: float
    slack: float
    reaction: int
    settled: int
    blind: bool
    width: float


@compiled
def in_reach(others: Others, limits: tuple[float, float], followers: bool) -> IntArray:
    """Rows of the vehicles that can come into reach of the ego, in order.

    Parameters
    ----------
    others : the vehicles, (v,).
    limits : the ego's greatest way, and the perception range, (2,) [m].
    followers : whether those behind count.
    """
    distance, perception = limits[0], limits[1]
    least, size, ahead, behind = others.least, others.size, others.ahead, others.behind
    rows, count = np.empty(ahead.shape[0], np.intp), 0
    for j in range(ahead.shape[0]):
        # Written so that a distance that is not a number drops nobody.
        if least[j] - size[j] > distance or not abs(ahead[j]) <= perception:
            continue
        # Whoever is behind may still be braking, and coming nearer, long after the ego stands: none of them is too far.
        if behind[j] and not followers:
            continue
        rows[count] = j
        count += 1
    return rows[:count]


@compiled
def _comes_back(paths: FloatArray, i: int, size: Footprint, low: float, high: float) -> bool:
    """Whether a path leaves the strip from `low` to `high` [m] with its buffer, and is in it again later: nobody keeps
    a place free that the ego has left."""
    lat, frames = size.across, paths.shape[1]
    least, most = np.inf, -np.inf
    for k in range(frames):
        least, most = min(least, paths[i, k, 1]), max(most, paths[i, k, 1])
    # The ego reaches as far to either side as its own width at any heading that a path has.
    if most - lat < high and least + lat > low:
        return False
    left = False
    for k in range(frames):
        r, psi = paths[i, k, 1], paths[i, k, 2]
        half = reach_across(size, psi)
        inside = r - half < high and r + half > low
        if inside and left:
            return True
        left = left or not inside
    return False


@compiled
def threats(
    others: Others,
    limits: tuple[float, float],
    lanes: IntArray,
    fails: IntArray,
    owned: BoolArray,
    centers: FloatArray,
    paths: FloatArray,
    size: Footprint,
) -> tuple[IntArray, BoolArray]:
    """Rows of those in reach who do not owe the ego their distance on every path, (m,); and who of them owes it on
    which path, (n, m) bool.

    Whoever is behind the ego with its buffer, in a lane that it owns, owes it the distance, but for a path that enters
    a lane that the ego does not own and that this vehicle touches, and for one that leaves its strip and comes back.

    Parameters
    ----------
    others, limits : as in `in_reach`.
    lanes, fails : what each path commits to and stops in, (n,). owned : which lanes the ego owns, (lanes,) bool.
    centers : of the lanes [m]. paths, size : (n, K, 4), and as in `least_separations`.
    """
    n, low, high, behind, held = lanes.shape[0], others.low, others.high, others.behind, others.held
    rows = in_reach(others, limits, True)
    owed, count = np.empty((n, rows.shape[0]), np.bool_), 0
    for j in rows:
        kept = False
        for i in range(n):
            entered = False
            for lane in (lanes[i], fails[i]):
                if not owned[lane]:
                    entered = entered or (low[j] < centers[lane] + TOUCH and high[j] > centers[lane] - TOUCH)
            owed[i, count] = behind[j] and held[j] and not entered
            if owed[i, count] and _comes_back(paths, i, size, low[j], high[j]):
                owed[i, count] = False
            kept = kept or not owed[i, count]
        if kept:
            rows[count] = j
            count += 1
    return rows[:count], owed[:, :count].copy()


@compiled
def lanes_held(
    r: float,
    centers: FloatArray,
    frames: int,
    sight: float,
    touch: float,
    stored: int,
    visible: IntArray,
    owned: BoolArray,
    coming: BoolArray,
) -> tuple[IntArray, BoolArray, BoolArray]:
    """The visibility clock, the lanes owned, and who could enter which before, one scene later.

    Parameters
    ----------
    r : lateral position of the ego [m]. centers : of the lanes [m].
    frames : since the scene before. sight, touch : how near to a lane's centre the ego is visible in it, and touches
        it [m].
    stored : the lane in which the stored fail-safe stops, or -1.
    visible, owned : of the scene before, (lanes,); both are empty in the first, and whoever is there when it all begins
        has seen the ego for long.
    coming : who could enter which lane in the scene before, (lanes, m) bool; of any other shape without one.

    Returns
    -------
    Frames for which the ego has been visible in each lane, (lanes,); whether it owns it, (lanes,) bool: from when it
    touches it with a verified plan to stop there, until it has left it; and `coming`, where anybody may come into a
    lane that the ego has got out of sight in.
    """
    n, first = centers.shape[0], visible.shape[0] != centers.shape[0]
    seen, own, comes = np.zeros(n, np.intp), np.zeros(n, np.bool_), coming.copy()
    here = 0
    for j in range(n):
        if abs(r - centers[j]) < abs(r - centers[here]):
            here = j
    for j in range(n):
        offset = abs(r - centers[j])
        if offset <= sight:
            seen[j] = (_LONG if first else visible[j]) + frames
        had = owned[j] if not first and owned.shape[0] > 0 else j == here
        own[j] = (had or j == stored) and offset < touch
        if not first and comes.shape[0] == n and visible[j] > 0 and seen[j] == 0:
            comes[j, :] = True
    return seen, own, comes


class Standing(NamedTuple):
    """Where the ego stands: `state` on the road (4,); `size`; `seen`, the same in the world; `owned`, which lanes it
    owns, and `visible`, for how many frames it has been visible in each, (lanes,); `stored`: the lane in which its
    stored fail-safe stops, or -1."""

    state: FloatArray
    size: Footprint
    seen: Ego
    owned: BoolArray
    visible: IntArray
    stored: int


@compiled
def others_of(
    rows: FloatArray,
    states: FloatArray,
    bodies: Bodies,
    ego: Standing,
    followers: FloatArray,
    before: BoolArray,
    sight: Sight,
    centers: FloatArray,
    others: Others,
) -> None:
    """Fill in the vehicles as a judgement of paths sees them, `others`.

    Parameters
    ----------
    rows, states, bodies : vehicle rows (m, 7), road states (m, 4), and what is known of their bodies.
    ego : where it stands.
    followers : who owed it the distance in the scene before, (m,) bool; empty without one.
    before : see `still_coming`; without a scene before, it has another shape.
    """
    state, size, owned = ego.state, ego.size, ego.owned
    lows, highs, floor, reach = bodies.low, bodies.high, bodies.floor, bodies.reach
    aheads, leasts, near, rs, across = others.ahead, others.least, others.size, others.r, others.across
    behinds, helds = others.behind, others.held
    half, side = reach_along(size, state[2]), reach_across(size, state[2])
    for j in range(states.shape[0]):
        ahead = states[j, 0] - state[0]
        sin, cos = math.sin(states[j, 2]), math.cos(states[j, 2])
        # Who is behind is told from where the body is now: its reach is for wherever it may turn to.
        beyond = ahead + 0.5 * (rows[j, _LENGTH] * abs(cos) + rows[j, _WIDTH] * abs(sin)) + half
        behind, followed = beyond <= 0, followers.shape[0] > 0 and followers[j]
        if followed and not behind and beyond <= _CORNER:
            # One that owes the ego its distance does so still where a corner of it has come beside a corner of the
            # ego's buffer, until it touches it.
            behind = gap_between(ego.seen, ego.seen.along, ego.seen.across, rows, j, 0.0) >= 0
        low, high, held = lows[j], highs[j], False
        for k in range(centers.shape[0]):
            held = held or (owned[k] and low < centers[k] + TOUCH and high > centers[k] - TOUCH)
        # The duty lasts until the ego has left the strip of the one that owes it.
        held = held or (followed and low < state[1] + side and high > state[1] - side)
        aheads[j], behinds[j], helds[j] = ahead, behind, held
        leasts[j] = min(ahead, floor[j] - state[0])
        near[j] = reach[j] + size.along + size.growth_along + 2.0
        rs[j], across[j] = states[j, 1], states[j, 3] * sin
    if not sight.blind:
        return
    tempted = gains(states, bodies.lane, bodies.low, bodies.high, centers, sight.distance, sight.slack)
    beside, may, turning = newcomers(others, tempted, centers, sight.width)
    last = before if before.shape == may.shape else may
    others.beside[:] = beside
    others.comes[:] = still_coming(beside, may, turning, last, ego.visible, ego.stored, sight.reaction, sight.settled)
