"""Who owes the ego its distance, and which lanes are its own: of whom a plan has to stay clear."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from dynamics.compiled import compiled
from dynamics.state import Vehicle
from dynamics.traffic.mobil import gains
from dynamics.traffic.occupancy_kernels import Bodies
from dynamics.traffic.permits import Ego, gap_between
from shield.certificate.clauses.entering import newcomers, still_coming
from shield.certificate.clauses.footprint import Footprint, reach_across, reach_along
from shield.certificate.clauses.others import TOUCH, Others

__all__ = ["Sight", "in_reach", "lanes_held", "others_of", "threats"]

_LENGTH, _WIDTH = int(Vehicle.LENGTH), int(Vehicle.WIDTH)
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
def in_reach(others: Others, limits: Any, followers: bool) -> Any:
    """Rows of the vehicles that can come into reach of the ego, in order.

    Parameters
    ----------
    others : the vehicles, (v,).
    limits : the ego's greatest way, and the perception range, (2,) [m].
    followers : whether those behind count.
    """
    distance, perception = limits[0], limits[1]
    rows, count = np.empty(others.ahead.shape[0], np.intp), 0
    for j in range(others.ahead.shape[0]):
        # Written so that a distance that is not a number drops nobody.
        if others.least[j] - others.size[j] > distance or not abs(others.ahead[j]) <= perception:
            continue
        # Whoever is behind may still be braking, and coming nearer, long after the ego stands: none of them is too far.
        if others.behind[j] and not followers:
            continue
        rows[count] = j
        count += 1
    return rows[:count]


@compiled
def _comes_back(paths: Any, i: int, size: Footprint, low: float, high: float) -> bool:
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
    others: Others, limits: Any, lanes: Any, fails: Any, owned: Any, centers: Any, paths: Any, size: Footprint
) -> tuple[Any, Any]:
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
    n = lanes.shape[0]
    rows = in_reach(others, limits, True)
    owed, count = np.empty((n, rows.shape[0]), np.bool_), 0
    for j in rows:
        kept = False
        for i in range(n):
            entered = False
            for lane in (lanes[i], fails[i]):
                if not owned[lane]:
                    entered = entered or (
                        others.low[j] < centers[lane] + TOUCH and others.high[j] > centers[lane] - TOUCH
                    )
            owed[i, count] = others.behind[j] and others.held[j] and not entered
            if owed[i, count] and _comes_back(paths, i, size, others.low[j], others.high[j]):
                owed[i, count] = False
            kept = kept or not owed[i, count]
        if kept:
            rows[count] = j
            count += 1
    return rows[:count], owed[:, :count].copy()


@compiled
def lanes_held(
    r: float, centers: Any, frames: int, sight: float, touch: float, stored: int, visible: Any, owned: Any
) -> tuple[Any, Any]:
    """The visibility clock and the lanes owned, one scene later.

    Parameters
    ----------
    r : lateral position of the ego [m]. centers : of the lanes [m].
    frames : since the scene before. sight, touch : how near to a lane's centre the ego is visible in it, and touches
        it [m].
    stored : the lane in which the stored fail-safe stops, or -1.
    visible, owned : of the scene before, (lanes,); `owned` is empty in the first.

    Returns
    -------
    Frames for which the ego has been visible in each lane, (lanes,); and whether it owns it, (lanes,) bool. A lane is
    owned from when the ego touches it with a verified plan to stop there, until it has left it.
    """
    n = centers.shape[0]
    seen, own = np.zeros(n, np.intp), np.zeros(n, np.bool_)
    here = 0
    for j in range(n):
        if abs(r - centers[j]) < abs(r - centers[here]):
            here = j
    for j in range(n):
        offset = abs(r - centers[j])
        if offset <= sight:
            seen[j] = visible[j] + frames
        had = owned[j] if owned.shape[0] > 0 else j == here
        own[j] = (had or j == stored) and offset < touch
    return seen, own


@compiled
def others_of(
    rows: Any,
    states: Any,
    bodies: Bodies,
    state: Any,
    size: Footprint,
    seen: Ego,
    owned: Any,
    followers: Any,
    before: Any,
    visible: Any,
    stored: int,
    sight: Sight,
    centers: Any,
) -> Others:
    """The vehicles as a judgement of paths sees them.

    Parameters
    ----------
    rows, states, bodies : vehicle rows (m, 7), road states (m, 4), and what is known of their bodies.
    state, size, seen : the ego's road state (4,), its footprint, and the same in the world frame.
    owned : which lanes it owns, (lanes,) bool. followers : who owed it the distance in the scene before, (m,) bool.
    before, visible, stored : see `still_coming`; without a scene before, `before` has another shape.
    """
    m = states.shape[0]
    ahead, least, near, across = np.empty(m), np.empty(m), np.empty(m), np.empty(m)
    behind, held = np.zeros(m, np.bool_), np.zeros(m, np.bool_)
    half, side = reach_along(size, state[2]), reach_across(size, state[2])
    for j in range(m):
        ahead[j] = states[j, 0] - state[0]
        sin, cos = math.sin(states[j, 2]), math.cos(states[j, 2])
        # Who is behind is told from where the body is now: its reach is for wherever it may turn to.
        beyond = ahead[j] + 0.5 * (rows[j, _LENGTH] * abs(cos) + rows[j, _WIDTH] * abs(sin)) + half
        behind[j] = beyond <= 0
        if followers[j] and not behind[j] and beyond <= _CORNER:
            # One that owes the ego its distance does so still where a corner of it has come beside a corner of the
            # ego's buffer, until it touches it.
            behind[j] = gap_between(seen, seen.along, seen.across, rows, j, 0.0) >= 0
        low, high = bodies.low[j], bodies.high[j]
        for k in range(centers.shape[0]):
            held[j] = held[j] or (owned[k] and low < centers[k] + TOUCH and high > centers[k] - TOUCH)
        # The duty lasts until the ego has left the strip of the one that owes it.
        held[j] = held[j] or (followers[j] and low < state[1] + side and high > state[1] - side)
        least[j] = min(ahead[j], bodies.floor[j] - state[0])
        near[j] = bodies.reach[j] + size.along + size.growth_along + 2.0
        across[j] = states[j, 3] * sin
    nobody = np.zeros((centers.shape[0], m), np.bool_)
    r = states[:, 1].copy()
    others = Others(ahead, least, near, behind, bodies.low, bodies.high, bodies.lane, r, across, held, nobody, nobody)
    if not sight.blind:
        return others
    tempted = gains(states, bodies.lane, bodies.low, bodies.high, centers, sight.distance, sight.slack)
    beside, may, turning = newcomers(others, tempted, centers, sight.width)
    last = before if before.shape == may.shape else may
    comes = still_coming(beside, may, turning, last, visible, stored, sight.reaction, sight.settled)
    return Others(ahead, least, near, behind, bodies.low, bodies.high, bodies.lane, r, across, held, beside, comes)
