"""All that is said against paths in one compiled call: who is in the way, where they can be, how near that comes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dynamics.compiled import compiled
from dynamics.traffic.occupancy_kernels import Bodies, Motion, rears
from shield.certificate.clauses.duties import threats
from shield.certificate.clauses.entering import sides_taken
from shield.certificate.clauses.footprint import Footprint
from shield.certificate.clauses.others import Others
from shield.certificate.clauses.room import rooms
from shield.certificate.clauses.separation import Duty, least_separations

__all__ = ["Around", "Ground", "judged"]


class Ground(NamedTuple):
    """Lanes and how far one looks: `centers` (lanes,), `width`, `lean`: how far a body may lean over a marking, and
    `perception` [m]; whether the road is `bent`, and whether anybody enters a lane `blind`ly."""

    centers: Any
    width: float
    lean: float
    perception: float
    bent: bool
    blind: bool


class Around(NamedTuple):
    """The others of a scene: `rows` (m, 7), `states` (m, 4), what a metre driven is of the road, `stretch` (2, m or 0),
    `bodies` and `motion`, `noses` (m, 2): greatest s of each body after one frame and two [m], and `others`."""

    rows: Any
    states: Any
    stretch: Any
    bodies: Bodies
    motion: Motion
    noses: Any
    others: Others


@compiled
def judged(
    paths: Any,
    lanes: Any,
    fails: Any,
    state: Any,
    size: Footprint,
    around: Around,
    owned: Any,
    visible: Any,
    ignored: Any,
    ground: Ground,
    duty: Duty,
) -> tuple[Any, Any, Any, Any]:
    """What is said against paths.

    Parameters
    ----------
    paths, lanes, fails : (n, K, 4), and the lane that each commits to, and stops in, (n,).
    state, size : of the ego: road state (4,), footprint.
    owned, visible : which lanes it owns, and for how many frames it has been visible in each, (lanes,).
    ignored : vehicles to leave out, (m,) bool, or none of them (0,).
    duty : `hold` frames of constant speed make a forecast of it, and no bound.

    Returns
    -------
    The least separation of each path from each vehicle in reach, (n, q) [m]; these vehicles, (q,); frames before the
    first that is negative, (n,); and the room in the lane that is stopped in, (n,) [m].
    """
    n, frames = paths.shape[0], paths.shape[1]
    others, centers = around.others, ground.centers
    room = rooms(paths, size, centers, fails, 0.5 * ground.width, ground.bent)
    distance = -np.inf
    for i in range(n):
        way = paths[i, frames - 1, 0] - state[0]
        # A way that is not a number drops nobody.
        distance = max(distance, way) if way == way else np.inf
    rows, owed = threats(others, (distance, ground.perception), lanes, fails, owned, centers, paths, size)
    if ignored.shape[0] > 0:
        kept = ~ignored[rows]
        rows, owed = rows[kept], owed[:, kept].copy()
    q = rows.shape[0]
    separations, reached = np.empty((n, q)), np.full(n, frames)
    if q == 0:
        return separations, rows, reached, room
    bound = ground.blind and duty.hold == 0
    low, high = np.empty((n if bound else 1, q)), np.empty((n if bound else 1, q))
    home = np.empty(low.shape, np.intp)
    if bound:
        settings = (state[1], duty.seen, ground.width, ground.lean)
        sides_taken(paths, lanes, fails, rows, others, centers, settings, low, high, home)
    else:
        low[0], high[0], home[0] = others.low[rows], others.high[rows], others.lane[rows]
    rear = np.empty((q, frames))
    rears(rows, around.rows, around.states, around.stretch, around.motion, around.bodies, duty.hold, rear)
    goals, at_once = np.empty(home.shape), np.full(home.shape, -1)
    for i in range(home.shape[0]):
        for j in range(q):
            goals[i, j] = centers[home[i, j]]
            already = visible[home[i, j]]
            if already > 0:
                at_once[i, j] = max(duty.reaction + 1 - already, 0)
    followers = np.ones((3, q))
    for j in range(q):
        followers[0, j] = around.states[rows[j], 3]
        followers[1, j] = around.states[rows[j], 0] + around.bodies.reach[rows[j]]
        if around.stretch.shape[1] > 0:
            followers[2, j] = around.stretch[1, rows[j]]
    least_separations(
        paths,
        size,
        low,
        high,
        rear,
        around.bodies.reach[rows],
        around.noses[rows].T.copy(),
        owed,
        others.behind[rows],
        goals,
        at_once,
        followers,
        duty,
        separations,
        reached,
    )
    return separations, rows, reached, room
