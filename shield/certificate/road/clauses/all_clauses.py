"""All clauses, evaluated for a set of paths in one compiled call.

The call takes plain arrays, which get their names inside; `dynamics.traffic.tables` gives the reason.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import compiled, kernel_inline, kernel_no_refcount, row_as_tuple
from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.state import Vehicle as Columns
from dynamics.traffic.occupancy_kernels import front_of, rear_of, straight_overshoot
from dynamics.traffic.tables import VehicleBodies, VehicleTables, bodies_in, motion_of
from shield.certificate.road.clauses.clause_inputs import EgoArrays, LaneState, PlannedPath
from shield.certificate.road.clauses.cut_in import (
    CutInBounds,
    any_cut_in,
    cut_in_separations,
    cut_ins_of,
    sweeps,
)
from shield.certificate.road.clauses.entering import LateralExtents, joins, lateral_extents, leaves_sight
from shield.certificate.road.clauses.followers import find_unobligated
from shield.certificate.road.clauses.footprint import Footprint
from shield.certificate.road.clauses.others import VehicleBuffers, vehicles_from
from shield.certificate.road.clauses.parameters import follower_response_of, settings_from
from shield.certificate.road.clauses.separation import UnobligatedVehicle, extents, separation, turns
from shield.certificate.road.clauses.stopping_room import margin_of, room_of
from shield.certificate.road.clauses.workspace import (
    ClauseScene,
    ClauseWorkspace,
    SceneVehicles,
    new_clause_workspace,
)

__all__ = [
    "CUT_IN_BINDS",
    "NOTHING_BINDS",
    "ROOM_BINDS",
    "SEPARATION_BINDS",
    "CandidatePaths",
    "SceneArrays",
    "evaluate_path",
    "evaluate_paths",
]

NOTHING_BINDS, SEPARATION_BINDS, CUT_IN_BINDS, ROOM_BINDS = 0, 1, 2, 3
"""Codes of the binding clause."""


_LENGTH, _WIDTH = int(Columns.LENGTH), int(Columns.WIDTH)
_AHEAD = 3
"""Frames computed beyond those needed, since the next path may be slightly longer."""


class CandidatePaths(NamedTuple):
    """n paths: road states of the ego after each frame, (n, K, 4); lanes that each commits to and stops in, (n,)."""

    paths: FloatArray
    lanes: IntArray
    fails: IntArray


class SceneArrays(NamedTuple):
    """A scene as arrays.

    Attributes
    ----------
    ego, lanes : the ego and the lanes.
    vehicles, of_others, cutting_in : the other vehicles, see `shield.certificate.road.clauses.scene.prepare_scene`.
    stretch : distance along the road for each metre driven, (2, m), or (2, 0) on a straight road.
    settings, motion : the numbers of `ClauseSettings` and of `Motion`.
    table : of the road, see `dynamics.vehicle.rollout_kernels`.
    """

    ego: EgoArrays
    lanes: LaneState
    vehicles: VehicleTables
    of_others: VehicleBuffers
    cutting_in: FloatArray
    stretch: FloatArray
    settings: FloatArray
    motion: FloatArray
    table: FloatArray


class _PathResults(NamedTuple):
    """Results of n paths among m vehicles: `found` (2 + m + c, n) and `marked` (3, n) as of `evaluate_paths`, and
    `near` (m,), the vehicles in reach of any path."""

    found: FloatArray
    marked: IntArray
    near: BoolArray


@kernel_inline
def _rears(
    workspace: ClauseWorkspace,
    frames: int,
    around: SceneVehicles,
    hold: int,
    rows: IntArray,
    out: FloatArray,
    last: bool,
) -> None:
    """Write the least s of the vehicles `rows` (n,) to `out`, (n, K) [m].

    Values that the workspace already holds are reused. With `last`, the last frame stands for all frames that follow.
    """
    bodies, kind = around.bodies, 0 if hold == 0 else 1
    vehicles = VehicleBodies(around.rows, around.states, bodies)
    for n in range(rows.shape[0]):
        j = rows[n]
        if workspace.done[kind, j] < frames:
            enough = min(frames + _AHEAD, workspace.rears.shape[2])
            rear_of(j, vehicles, around.stretch, around.motion, hold, workspace.rears[kind, j, :enough])
            workspace.done[kind, j] = enough
        for k in range(frames):
            out[n, k] = workspace.rears[kind, j, k]
        if last and hold == 0:
            out[n, frames - 1] = min(out[n, frames - 1], bodies.floor[j] - bodies.reach[j])


@kernel_inline
def _lateral(plan: PlannedPath, scene: ClauseScene, q: int, hold: int, workspace: ClauseWorkspace) -> tuple[int, int]:
    """Write the lateral extents of the first `q` vehicles of `desk.near` to `desk.sides`, and their lanes to
    `desk.home`. Return the frames from which the ego is not visible in the lanes that the path commits to and stops in,
    or K."""
    frames, near, home, low, high = (
        plan.path.shape[0],
        workspace.near,
        workspace.home,
        workspace.sides[0],
        workspace.sides[1],
    )
    others, centers, x = scene.around.others, scene.ground.centers, scene.settings
    lane, fail, r, path, widths = plan.lane, plan.fail, scene.state[1], plan.path, scene.around.rows[:, _WIDTH]
    if x.simultaneous_merge > 0 and hold == 0:
        out = LateralExtents(low, high, home)
        lateral_extents((lane, fail), near[:q], others, widths, centers, x.lateral_deviation, out)
        return leaves_sight(r, path, centers[lane], x.seen), leaves_sight(r, path, centers[fail], x.seen)
    for j in range(q):
        low[j], high[j], home[j] = others.low[near[j]], others.high[near[j]], others.lane[near[j]]
    return frames, frames


@kernel_inline
def _widened(
    k: int, sides: tuple[float, float], since: tuple[int, int], plan: PlannedPath, scene: ClauseScene
) -> tuple[float, float, int]:
    """Lateral extents of vehicle `k` once the ego is no longer visible in a lane [m], and the frame from which they
    hold. `sides` are its lateral extents until then [m]; `since` as returned by `_lateral`."""
    (most_left, most_right), later = sides, plan.path.shape[0]
    if min(since[0], since[1]) < later:
        others, centers, x = scene.around.others, scene.ground.centers, scene.settings
        frames, core = later, 0.5 * scene.around.rows[k, _WIDTH] + x.lateral_deviation
        later = min(since[0], since[1])
        for step in range(2):
            if since[step] < frames:
                goal = centers[plan.lane if step == 0 else plan.fail]
                low_most, high_most = joins(others.low[k], others.high[k], goal, core, x.width)
                most_left, most_right = min(most_left, low_most), max(most_right, high_most)
    return most_left, most_right, later


@kernel_inline
def _overshoot(j: int, scene: ClauseScene) -> float:
    """How far vehicle j may leave its bend by a frame of straight motion [m]; 0 on a straight road."""
    x = scene.settings
    if not x.curvature > 0:
        return 0.0
    distance = max(abs(scene.around.states[j, 3]), x.bend_speed) * x.dt
    return straight_overshoot(x.curvature, scene.around.rows[j, _LENGTH], distance)


@kernel_inline
def _separations(plan: PlannedPath, scene: ClauseScene, q: int, hold: int, workspace: ClauseWorkspace) -> int:
    """Write the least separation of a path from each of the first `q` vehicles of `desk.near`, which have no distance
    obligation, to `desk.apart` [m]. Return the number of frames before the first negative separation."""
    frames, near, home, found = plan.path.shape[0], workspace.near, workspace.home, workspace.apart
    x, foot, around, others = scene.settings, scene.foot, scene.around, scene.around.others
    centers, visible, response = scene.ground.centers, scene.ground.visible, follower_response_of(x, hold)
    since = _lateral(plan, scene, q, hold, workspace)
    ego = extents(plan.path, plan.turned, foot, (x.curvature, x.dt), workspace.bounds)
    if not ego.finite:
        for j in range(q):
            found[j] = np.nan
        return 0
    bodies, states, stretch, reached = around.bodies, around.states, around.stretch, frames
    for j in range(q):
        k, left, right = near[j], workspace.sides[0, j], workspace.sides[1, j]
        s, v, length = states[k, 0], states[k, 3], bodies.reach[k]
        most_left, most_right, later = _widened(k, (left, right), since, plan, scene)
        beside = max(most_left - ego.highest, ego.lowest - most_right)
        about = s + v + length + bodies.floor[k] + bodies.budget[k] + bodies.action[k]
        overshoot = _overshoot(k, scene)
        if beside >= max(overshoot, ego.overshoot) and math.isfinite(left + right + about):
            # Its longitudinal position makes no difference.
            found[j] = beside
            continue
        _rears(workspace, frames, around, hold, near[j : j + 1], workspace.rear, True)
        goal, at_once, already = centers[home[j]], -1, visible[home[j]]
        if already > 0:
            at_once = max(response.reaction + 1 - already, 0)
        most = stretch[1, k] if stretch.shape[1] > 0 else 1.0
        other = UnobligatedVehicle(
            left,
            right,
            most_left,
            most_right,
            later,
            length,
            overshoot,
            others.behind[k],
            goal,
            at_once,
            v,
            s + length,
            most,
        )
        found[j], first = separation(plan, ego, workspace.bounds, foot, other, workspace.rear[0], response)
        reached = min(reached, first)
    return reached


@kernel_inline
def _cut_ins(
    path: FloatArray, scene: ClauseScene, found: FloatArray, ignored: BoolArray, workspace: ClauseWorkspace
) -> None:
    """Write the least separation of a path from each candidate for a cut-in, a row of `found`, to `desk.away` [m]; +inf
    where it does not cut in."""
    frames, c, out = path.shape[0], found.shape[0], workspace.away
    for k in range(c):
        out[k] = np.inf
    if c == 0:
        return
    around, centers, rows = scene.around, scene.ground.centers, workspace.cutting_in[:c]
    vehicles = VehicleBodies(around.rows, around.states, around.bodies)
    cut_ins = cut_ins_of(found, vehicles, centers, scene.settings, rows, workspace.cut_ins[:, :c])
    if not any_cut_in(path, cut_ins, centers):
        return
    # None of the requested frames stands for all frames that follow.
    rear, front, sweep = workspace.ways[0, :c], workspace.ways[1, :c], workspace.sweep[:c]
    if workspace.swept[0] < frames:
        enough = min(frames + _AHEAD, workspace.ways.shape[2])
        _rears(workspace, enough, around, 0, rows, rear, False)
        for k in range(c):
            front_of(rows[k], vehicles, around.stretch, around.motion, 0, front[k, :enough])
        sweeps(rows, cut_ins, vehicles, scene.table, workspace.turns[:c], sweep)
        workspace.swept[0] = enough
    cut_in_separations(path, scene.foot, cut_ins, CutInBounds(rear, front, sweep), centers, out)
    if ignored.shape[0] > 0:
        for k in range(c):
            if ignored[rows[k]]:
                out[k] = np.inf


@kernel_inline
def _binding(margin: float, q: int, c: int, cut_ins: FloatArray, workspace: ClauseWorkspace) -> tuple[int, int]:
    """The binding clause of a margin, and the row of the binding vehicle."""
    least, at = np.inf, -1
    for j in range(q):
        if at < 0 or workspace.apart[j] < least:
            least, at = workspace.apart[j], j
    if at >= 0 and least <= margin:
        return SEPARATION_BINDS, workspace.near[at]
    least, at = np.inf, -1
    for k in range(c):
        if at < 0 or workspace.away[k] < least:
            least, at = workspace.away[k], k
    if at >= 0 and least <= margin:
        return CUT_IN_BINDS, int(cut_ins[at, 0])
    return (NOTHING_BINDS if margin == np.inf else ROOM_BINDS), -1


@kernel_inline
def _widest_overshoot(scene: ClauseScene) -> float:
    """Greatest overshoot of any vehicle [m], see `_overshoot`; -1 on a straight road."""
    if not scene.settings.curvature > 0:
        return -1.0
    widest = 0.0
    for j in range(scene.around.rows.shape[0]):
        widest = max(widest, _overshoot(j, scene))
    return widest


@kernel_inline
def evaluate_path(
    plan: PlannedPath, scene: ClauseScene, hold: int, ignored: BoolArray, workspace: ClauseWorkspace
) -> tuple[float, int, int, int]:
    """Evaluate the clauses for one path.

    Parameters
    ----------
    hold, ignored : as in `evaluate_paths`.
    workspace : workspace. Written: the vehicles in reach, `near`; the separations from them, `apart`; those from
        cut-ins, `away`; and the room, `room`.

    Returns
    -------
    The margin [m], the number of frames before the first negative separation, the binding clause, and the row of the
    binding vehicle.
    """
    path, turned, foot, ground, x = plan.path, plan.turned, scene.foot, scene.ground, scene.settings
    frames, others, state, cutting_in = path.shape[0], scene.around.others, scene.state, scene.cutting_in
    workspace.room[0] = room_of(path, turned, foot, ground.centers[plan.fail], 0.5 * x.width, _widest_overshoot(scene))
    way = path[frames - 1, 0] - state[0]
    # A distance that is not a number excludes no vehicle.
    reach = (way if way == way else np.inf, x.perception)
    q = find_unobligated(others, reach, plan, ground, state, foot, workspace.near)
    if ignored.shape[0] > 0:
        kept = 0
        for j in range(q):
            if not ignored[workspace.near[j]]:
                workspace.near[kept] = workspace.near[j]
                kept += 1
        q = kept
    reached = frames
    if q > 0:
        reached = _separations(plan, scene, q, hold, workspace)
    c = cutting_in.shape[0] if hold == 0 else 0
    _cut_ins(path, scene, cutting_in[:c], ignored, workspace)
    margin = margin_of(workspace.apart[:q], workspace.away[:c], workspace.room[0])
    if q == 0:
        for k in range(frames):
            if not math.isfinite(path[k, 0] + path[k, 1] + path[k, 2] + path[k, 3]):
                margin = np.nan
    clause, vehicle = _binding(margin, q, c, cutting_in, workspace)
    workspace.found[0] = q
    return margin, reached, clause, vehicle


@kernel_inline
def _named(scene: SceneArrays) -> ClauseScene:
    """Name the rows of the arrays of a scene."""
    vehicles, of_others, foot = bodies_in(scene.vehicles), scene.of_others, Footprint(*row_as_tuple(scene.ego.size, 8))
    bodies, motion, settings = vehicles.bodies, motion_of(scene.motion), settings_from(scene.settings)
    others = vehicles_from(bodies, of_others.numbers, of_others.flags)
    around = SceneVehicles(vehicles.rows, vehicles.states, scene.stretch, bodies, motion, others)
    return ClauseScene(scene.ego.state, around, scene.lanes, scene.cutting_in, foot, settings, scene.table)


@kernel_no_refcount
def _verify_each(
    candidates: CandidatePaths,
    arrays: SceneArrays,
    hold: int,
    ignored: BoolArray,
    workspace: ClauseWorkspace,
    out: _PathResults,
) -> None:
    """Fill in the results of `evaluate_paths`."""
    scene, paths, found, marked, near = _named(arrays), candidates.paths, out.found, out.marked, out.near
    m = near.shape[0]
    for i in range(paths.shape[0]):
        turns(paths[i], workspace.turned)
        plan = PlannedPath(paths[i], workspace.turned, candidates.lanes[i], candidates.fails[i])
        margin, reached, clause, vehicle = evaluate_path(plan, scene, hold, ignored, workspace)
        found[0, i], found[1, i] = margin, workspace.room[0]
        marked[0, i], marked[1, i], marked[2, i] = reached, clause, vehicle
        for j in range(workspace.found[0]):
            near[workspace.near[j]] = True
            found[2 + workspace.near[j], i] = workspace.apart[j]
        for k in range(found.shape[0] - 2 - m):
            found[2 + m + k, i] = workspace.away[k]


@compiled
def evaluate_paths(
    candidates: CandidatePaths, scene: SceneArrays, hold: int, ignored: BoolArray
) -> tuple[FloatArray, IntArray, IntArray]:
    """Evaluate the clauses for n paths, each independently of the others.

    Parameters
    ----------
    hold : number of frames of constant speed that are expected of the others. If above 0, the result is a forecast and
        not a bound.
    ignored : vehicles to leave out, (m,) bool; empty for none.

    Returns
    -------
    found : a row for each term, (2 + q + c, n) [m]: the margin, the room in the lane that the path stops in, the
        separation from each vehicle in reach of any path, and that from each cut-in.
    marked : number of frames before the first negative separation, binding clause, and binding vehicle, (3, n).
    near : rows of the vehicles in reach of any path, (q,).
    """
    n, frames, m = candidates.paths.shape[0], candidates.paths.shape[1], scene.vehicles.states.shape[0]
    c = scene.cutting_in.shape[0] if hold == 0 else 0
    workspace, near = new_clause_workspace(m, frames, scene.settings[14]), np.zeros(m, np.bool_)
    found, marked = np.full((2 + m + c, n), np.inf), np.empty((3, n), np.intp)
    _verify_each(candidates, scene, hold, ignored, workspace, _PathResults(found, marked, near))
    kept = np.ones(2 + m + c, np.bool_)
    kept[2 : 2 + m] = near
    return found[kept], marked, np.flatnonzero(near)
