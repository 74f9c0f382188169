"""All clauses, evaluated for a set of paths in one compiled call.

The call takes plain arrays, which get their names inside; `dynamics.traffic.tables` gives the reason.
"""

from __future__ import annotations

import math

import numpy as np

from dynamics.compiled import compiled, kernel_inline, kernel_no_refcount, row_as_tuple
from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.state import Vehicle as Columns
from dynamics.traffic.occupancy_kernels import front_of, rear_of
from dynamics.traffic.tables import bodies_of, motion_of
from shield.certificate.road.clauses.cut_in import (
    any_cut_in,
    cut_in_separations,
    cut_ins_of,
    sweeps,
)
from shield.certificate.road.clauses.entering import joins, lateral_extents, leaves_sight
from shield.certificate.road.clauses.followers import find_unobligated
from shield.certificate.road.clauses.footprint import Footprint
from shield.certificate.road.clauses.others import vehicles_from
from shield.certificate.road.clauses.parameters import ClauseSettings, follower_response_of, settings_from
from shield.certificate.road.clauses.separation import UnobligatedVehicle, extents, separation, turns
from shield.certificate.road.clauses.stopping_room import margin_of, room_of
from shield.certificate.road.clauses.workspace import ClauseWorkspace, LaneState, SceneVehicles, new_clause_workspace

__all__ = [
    "CUT_IN_BINDS",
    "NOTHING_BINDS",
    "ROOM_BINDS",
    "SEPARATION_BINDS",
    "evaluate_path",
    "evaluate_paths",
]

NOTHING_BINDS, SEPARATION_BINDS, CUT_IN_BINDS, ROOM_BINDS = 0, 1, 2, 3
"""Codes of the binding clause."""


_WIDTH = int(Columns.WIDTH)
_AHEAD = 3
"""Frames computed beyond those needed, since the next path may be slightly longer."""


@kernel_inline
def _rears(
    desk: ClauseWorkspace,
    count: int,
    frames: int,
    around: SceneVehicles,
    hold: int,
    rows: IntArray,
    out: FloatArray,
    last: bool,
) -> None:
    """Write the least s of the first `count` vehicles of `rows` to `out`, (count, K) [m].

    Values that the workspace already holds are reused. With `last`, the last frame stands for all frames that follow.
    """
    bodies, kind = around.bodies, 0 if hold == 0 else 1
    for n in range(count):
        j = rows[n]
        if desk.done[kind, j] < frames:
            enough = min(frames + _AHEAD, desk.rears.shape[2])
            rear_of(
                j, around.rows, around.states, around.stretch, around.motion, bodies, hold, enough, desk.rears[kind, j]
            )
            desk.done[kind, j] = enough
        for k in range(frames):
            out[n, k] = desk.rears[kind, j, k]
        if last and hold == 0:
            out[n, frames - 1] = min(out[n, frames - 1], bodies.floor[j] - bodies.reach[j])


@kernel_inline
def _separations(
    path: FloatArray,
    lane: int,
    fail: int,
    r: float,
    foot: Footprint,
    ground: LaneState,
    around: SceneVehicles,
    q: int,
    x: ClauseSettings,
    hold: int,
    desk: ClauseWorkspace,
) -> int:
    """Write the least separation of a path from each of the first `q` vehicles of `desk.near`, which have no distance
    obligation, to `desk.apart` [m]. `r` is the lateral position of the ego now [m]. Return the number of frames before
    the first negative separation."""
    frames, near, visible, home, found = path.shape[0], desk.near, ground.visible, desk.home, desk.apart
    others, centers, duty, low, high = (
        around.others,
        ground.centers,
        follower_response_of(x, hold),
        desk.sides[0],
        desk.sides[1],
    )
    since = frames, frames
    if x.blind > 0 and hold == 0:
        lateral_extents(lane, fail, near[:q], others, around.rows[:, _WIDTH], centers, x.waver, low, high, home)
        since = leaves_sight(r, path, centers[lane], x.seen), leaves_sight(r, path, centers[fail], x.seen)
    else:
        for j in range(q):
            low[j], high[j], home[j] = others.low[near[j]], others.high[near[j]], others.lane[near[j]]
    ego = extents(path, desk.turned, foot, x.dt, desk.bounds)
    if not ego.finite:
        for j in range(q):
            found[j] = np.nan
        return 0
    bodies, states, stretch, reached = around.bodies, around.states, around.stretch, frames
    for j in range(q):
        k, left, right = near[j], low[j], high[j]
        s, v, length = states[k, 0], states[k, 3], bodies.reach[k]
        most_left, most_right, later = left, right, frames
        if min(since[0], since[1]) < frames:
            later, core = min(since[0], since[1]), 0.5 * around.rows[k, _WIDTH] + x.waver
            for step in range(2):
                if since[step] < frames:
                    goal = centers[lane if step == 0 else fail]
                    low_most, high_most = joins(others.low[k], others.high[k], goal, core, x.width)
                    most_left, most_right = min(most_left, low_most), max(most_right, high_most)
        beside = max(most_left - ego.highest, ego.lowest - most_right)
        about = s + v + length + bodies.floor[k] + bodies.budget[k] + bodies.action[k]
        if beside >= 0 and math.isfinite(left + right + about):
            # Its longitudinal position makes no difference.
            found[j] = beside
            continue
        _rears(desk, 1, frames, around, hold, near[j : j + 1], desk.rear, True)
        goal, at_once, already = centers[home[j]], -1, visible[home[j]]
        if already > 0:
            at_once = max(duty.reaction + 1 - already, 0)
        most = stretch[1, k] if stretch.shape[1] > 0 else 1.0
        other = UnobligatedVehicle(
            left, right, most_left, most_right, later, length, others.behind[k], goal, at_once, v, s + length, most
        )
        found[j], first = separation(
            path, desk.turned, ego, desk.bounds, foot, other, desk.rear[0], duty, desk.bounds[4]
        )
        reached = min(reached, first)
    return reached


@kernel_inline
def _slips(
    path: FloatArray,
    foot: Footprint,
    centers: FloatArray,
    table: FloatArray,
    ignored: BoolArray,
    around: SceneVehicles,
    found: FloatArray,
    x: ClauseSettings,
    desk: ClauseWorkspace,
) -> None:
    """Write the least separation of a path from each candidate for a cut-in, a row of `found`, to `desk.away` [m]; +inf
    where it does not cut in."""
    frames, c, out = path.shape[0], found.shape[0], desk.away
    for k in range(c):
        out[k] = np.inf
    if c == 0:
        return
    rows, numbers = desk.slipping[:c], desk.slips
    bodies, states = around.bodies, around.states
    slips = cut_ins_of(
        found, states, bodies, centers, x.acceleration, x.hardest, rows, numbers[:4, :c], numbers[4:6, :c]
    )
    if not any_cut_in(path, slips, centers, x.seen, x.dt):
        return
    # None of the requested frames stands for all frames that follow.
    rear, front, sweep = desk.ways[0, :c], desk.ways[1, :c], desk.sweep[:c]
    if desk.swept[0] < frames:
        enough = min(frames + _AHEAD, desk.ways.shape[2])
        _rears(desk, c, enough, around, 0, rows, rear, False)
        for k in range(c):
            front_of(rows[k], states, around.stretch, around.motion, bodies, 0, enough, front[k])
        sweeps(rows, slips, around.rows, states, bodies, table, x.dt, desk.turns[:c], sweep)
        desk.swept[0] = enough
    cut_in_separations(path, foot, slips, rear, front, sweep, centers, x.seen, x.dt, out)
    if ignored.shape[0] > 0:
        for k in range(c):
            if ignored[rows[k]]:
                out[k] = np.inf


@kernel_inline
def _binding(margin: float, q: int, c: int, slips: FloatArray, desk: ClauseWorkspace) -> tuple[int, int]:
    """The binding clause of a margin, and the row of the binding vehicle."""
    least, at = np.inf, -1
    for j in range(q):
        if at < 0 or desk.apart[j] < least:
            least, at = desk.apart[j], j
    if at >= 0 and least <= margin:
        return SEPARATION_BINDS, desk.near[at]
    least, at = np.inf, -1
    for k in range(c):
        if at < 0 or desk.away[k] < least:
            least, at = desk.away[k], k
    if at >= 0 and least <= margin:
        return CUT_IN_BINDS, int(slips[at, 0])
    return (NOTHING_BINDS if margin == np.inf else ROOM_BINDS), -1


@kernel_inline
def evaluate_path(
    path: FloatArray,
    lane: int,
    fail: int,
    state: FloatArray,
    foot: Footprint,
    x: ClauseSettings,
    table: FloatArray,
    hold: int,
    ground: LaneState,
    ignored: BoolArray,
    around: SceneVehicles,
    slipping: FloatArray,
    desk: ClauseWorkspace,
) -> tuple[float, int, int, int]:
    """Evaluate the clauses for one path.

    Parameters
    ----------
    path : road states of the ego after each frame, (K, 4). lane, fail : lanes that it commits to and stops in.
    state : road state of the ego now, (4,). foot : its footprint. x : settings of the clauses.
    slipping : candidates for a cut-in, (c, 4), see `find_cut_ins`.
    desk : workspace, with the sine and cosine of the path's headings in `turned`. Written: the vehicles in reach,
        `near`; the separations from them, `apart`; those from cut-ins, `away`; and the room, `room`.
    table, hold, ground, ignored, around : as in `evaluate_paths`.

    Returns
    -------
    The margin [m], the number of frames before the first negative separation, the binding clause, and the row of the
    binding vehicle.
    """
    frames, others, centers = path.shape[0], around.others, ground.centers
    desk.room[0] = room_of(path, desk.turned, foot, centers[fail], 0.5 * x.width, x.bent > 0)
    way = path[frames - 1, 0] - state[0]
    # A distance that is not a number excludes no vehicle.
    reach = (way if way == way else np.inf, x.perception)
    q = find_unobligated(others, reach, lane, fail, ground.owned, centers, state, path, desk.turned, foot, desk.near)
    if ignored.shape[0] > 0:
        kept = 0
        for j in range(q):
            if not ignored[desk.near[j]]:
                desk.near[kept] = desk.near[j]
                kept += 1
        q = kept
    reached = frames
    if q > 0:
        reached = _separations(path, lane, fail, state[1], foot, ground, around, q, x, hold, desk)
    c = slipping.shape[0] if hold == 0 else 0
    _slips(path, foot, centers, table, ignored, around, slipping[:c], x, desk)
    margin = margin_of(desk.apart[:q], desk.away[:c], desk.room[0])
    if q == 0:
        for k in range(frames):
            if not math.isfinite(path[k, 0] + path[k, 1] + path[k, 2] + path[k, 3]):
                margin = np.nan
    clause, vehicle = _binding(margin, q, c, slipping, desk)
    desk.found[0] = q
    return margin, reached, clause, vehicle


@kernel_no_refcount
def _judge_each(
    paths: FloatArray,
    lanes: IntArray,
    fails: IntArray,
    state: FloatArray,
    size: FloatArray,
    centers: FloatArray,
    settings: FloatArray,
    motion: FloatArray,
    table: FloatArray,
    hold: int,
    owned: BoolArray,
    visible: IntArray,
    ignored: BoolArray,
    rows: FloatArray,
    states: FloatArray,
    stretch: FloatArray,
    marks: IntArray,
    numbers: FloatArray,
    brakes: FloatArray,
    recent: FloatArray,
    of_others: FloatArray,
    flags: BoolArray,
    slipping: FloatArray,
    desk: ClauseWorkspace,
    found: FloatArray,
    marked: IntArray,
    near: BoolArray,
) -> None:
    """Fill in the arrays of `evaluate_paths`: `found` (2 + m + c, n), `marked` (3, n), and `near` (m,), the vehicles
    in reach of any path."""
    m, x, foot = states.shape[0], settings_from(settings), Footprint(*row_as_tuple(size, 8))
    bodies = bodies_of(marks, numbers, brakes, recent)
    around = SceneVehicles(rows, states, stretch, bodies, motion_of(motion), vehicles_from(bodies, of_others, flags))
    ground = LaneState(centers, owned, visible)
    for i in range(paths.shape[0]):
        turns(paths[i], desk.turned)
        margin, reached, clause, vehicle = evaluate_path(
            paths[i], lanes[i], fails[i], state, foot, x, table, hold, ground, ignored, around, slipping, desk
        )
        found[0, i], found[1, i] = margin, desk.room[0]
        marked[0, i], marked[1, i], marked[2, i] = reached, clause, vehicle
        for j in range(desk.found[0]):
            near[desk.near[j]] = True
            found[2 + desk.near[j], i] = desk.apart[j]
        for k in range(found.shape[0] - 2 - m):
            found[2 + m + k, i] = desk.away[k]


@compiled
def evaluate_paths(
    paths: FloatArray,
    lanes: IntArray,
    fails: IntArray,
    state: FloatArray,
    size: FloatArray,
    centers: FloatArray,
    settings: FloatArray,
    motion: FloatArray,
    table: FloatArray,
    hold: int,
    owned: BoolArray,
    visible: IntArray,
    ignored: BoolArray,
    rows: FloatArray,
    states: FloatArray,
    stretch: FloatArray,
    marks: IntArray,
    numbers: FloatArray,
    brakes: FloatArray,
    recent: FloatArray,
    of_others: FloatArray,
    flags: BoolArray,
    slipping: FloatArray,
) -> tuple[FloatArray, IntArray, IntArray]:
    """Evaluate the clauses for n paths, each independently of the others.

    Parameters
    ----------
    paths : road states of the ego after each frame, (n, K, 4).
    lanes, fails : lanes that each path commits to and stops in, (n,).
    state, size : road state of the ego, (4,), and the numbers of its `Footprint`, (8,).
    centers : lateral positions of the lane centres, (lanes,) [m].
    settings, motion : the numbers of `ClauseSettings` and of `Motion`.
    table : of the road, see `dynamics.vehicle.rollout_kernels`.
    hold : number of frames of constant speed that are expected of the others. If above 0, the result is a forecast and
        not a bound.
    owned, visible : whether the ego owns each lane, and the number of frames for which it has been visible there,
        (lanes,).
    ignored : vehicles to leave out, (m,) bool; empty for none.
    rows, states, marks, numbers, brakes, recent, of_others, flags, slipping : the other vehicles, see
        `shield.certificate.road.clauses.scene.prepare_scene`.
    stretch : distance along the road for each metre driven, (2, m), or (2, 0) on a straight road.

    Returns
    -------
    found : a row for each term, (2 + q + c, n) [m]: the margin, the room in the lane that the path stops in, the
        separation from each vehicle in reach of any path, and that from each cut-in.
    marked : number of frames before the first negative separation, binding clause, and binding vehicle, (3, n).
    near : rows of the vehicles in reach of any path, (q,).
    """
    n, frames, m = paths.shape[0], paths.shape[1], states.shape[0]
    c = slipping.shape[0] if hold == 0 else 0
    desk, near = new_clause_workspace(m, frames, settings[15]), np.zeros(m, np.bool_)
    found, marked = np.full((2 + m + c, n), np.inf), np.empty((3, n), np.intp)
    scene = (state, size, centers, settings, motion, table, hold, owned, visible, ignored)
    others = (rows, states, stretch, marks, numbers, brakes, recent, of_others, flags, slipping)
    _judge_each(paths, lanes, fails, *scene, *others, desk, found, marked, near)
    kept = np.ones(2 + m + c, np.bool_)
    kept[2 : 2 + m] = near
    return found[kept], marked, np.flatnonzero(near)
