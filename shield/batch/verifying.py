"""Judges candidates one after another: each tracks a target for some frames, then brakes to a stop."""

from __future__ import annotations

import math

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.pass_by_pointer import Pointer, dereference
from dynamics.state import BoolArray, FloatArray
from dynamics.vehicle.controllers import KP_SPEED
from dynamics.vehicle.rollout_kernels import StopTarget, roll_frame, slip_at
from shield.batch.arrays import BatchPointers
from shield.batch.parameters import NO_INDEX, BatchParameters
from shield.certificate.road.clauses.all_clauses import SEPARATION_BINDS, evaluate_path
from shield.certificate.road.clauses.clause_inputs import PlannedPath
from shield.certificate.road.clauses.footprint import across_of, along_of
from shield.certificate.road.clauses.workspace import ClauseScene, ClauseWorkspace

__all__ = ["frames_of", "verify"]


@kernel_inline
def frames_of(parameters: BatchParameters, v: float, most: float, commit: int) -> int:
    """Number of frames after which every candidate stands that commits, at speed `v`, to at most `most` [m/s]; see
    `shield.certificate.road.manoeuvres.brake_candidates`."""
    numbers = parameters.numbers
    decay = 1 - KP_SPEED * numbers.dt if commit == 1 else numbers.decay
    top = max(v, most + (v - most) * decay, 0.0)
    return commit + math.ceil(top / (numbers.braking * numbers.dt)) + 1


@kernel_inline
def _touches(s: float, r: float, sin: float, cos: float, rear: float, j: int, scene: ClauseScene) -> bool:
    """Whether the ego's buffer certainly overlaps with a place that vehicle `j` can reach; its body is no further back
    than `rear` [m]."""
    foot, others = scene.foot, scene.around.others
    half = across_of(foot, sin, cos)
    beside = others.low[j] - (r + half) < 0 and (r - half) - others.high[j] < 0
    return beside and rear - (s + along_of(foot, sin, cos)) < 0


@kernel_inline
def _roll(
    scene: ClauseScene,
    target: StopTarget,
    dt: float,
    path: FloatArray,
    clause_workspace: ClauseWorkspace,
    suspect: int,
    reached: int,
) -> bool:
    """Roll out a candidate to `path`, (K, 4), see `dynamics.vehicle.rollout_kernels.roll_stop`, with the sine and
    cosine of its headings in `desk.turned`.

    Parameters
    ----------
    dt : frame [s]. clause_workspace : workspace of the clauses.
    suspect : vehicle that is checked during the rollout, or `NO_INDEX`. reached : first frame of this check.

    Returns
    -------
    False as soon as the candidate `_touches` the suspect.
    """
    state, frames, turned, rears, table = (
        scene.state,
        path.shape[0],
        clause_workspace.turned,
        clause_workspace.rears,
        scene.table,
    )
    s, r, psi, v = state[0], state[1], state[2], state[3]
    sin, cos = math.sin(psi), math.cos(psi)
    for f in range(frames):
        to, a = target.goal, KP_SPEED * (target.speed - v)
        if f >= target.commit:
            to, a = target.last_goal, -target.braking
        a, slip = max(a, max(v, 0.0) * (-1 / dt)), slip_at(s, r, psi, v, to, table, dt)
        s, r, psi, v = roll_frame((s, r, psi, v), (sin, cos), a, slip, table, dt)
        sin, cos = math.sin(psi), math.cos(psi)
        path[f, 0], path[f, 1], path[f, 2], path[f, 3] = s, r, psi, v
        turned[0, f], turned[1, f] = sin, cos
        asked = suspect != NO_INDEX and reached <= f < frames - 1
        if asked and _touches(s, r, sin, cos, rears[0, suspect, f], suspect, scene):
            return False
    return True


@kernel_no_refcount
def verify(
    pointers: BatchPointers,
    scene_pointer: Pointer[ClauseScene],
    n: int,
    horizon: tuple[int, int],
    hold: int,
    ignored: BoolArray,
    first: int,
) -> int:
    """Judge the first `n` candidates of the workspace. With `first` 1, stop at the first that verifies; of those before
    it, only their failure is known.

    Parameters
    ----------
    scene_pointer : the scene. horizon : number of frames of commitment to the target, and in total.
    hold, ignored : see `evaluate_path`.

    Returns
    -------
    The first candidate that verifies, or -1.
    """
    scene, parameters, workspace = (
        dereference(scene_pointer),
        dereference(pointers.parameters),
        dereference(pointers.workspace),
    )
    commit, frames, braking, dt = horizon[0], horizon[1], parameters.numbers.braking, parameters.numbers.dt
    plans, clause_workspace, found, behind = (
        workspace.plans,
        workspace.clause_workspace,
        NO_INDEX,
        scene.around.others.behind,
    )
    suspect, reached = NO_INDEX, 0
    if (
        first > 0
        and hold == 0
        and workspace.suspect[0] != NO_INDEX
        and clause_workspace.done[0, workspace.suspect[0]] >= frames
    ):
        suspect, reached = workspace.suspect[0], workspace.suspect[1]
    if frames > workspace.path.shape[0]:
        # The rollout is longer than the buffer: no candidate verifies.
        for i in range(n):
            plans.margins[i], plans.clear[i], plans.clauses[i], plans.vehicles[i] = -math.inf, 0, 0, NO_INDEX
        clause_workspace.found[0] = 0
        return NO_INDEX
    path = workspace.path[:frames]
    for i in range(n):
        lane, fail = plans.lanes[i], plans.fails[i]
        target = StopTarget(parameters.centers[lane], parameters.centers[fail], plans.speeds[i], commit, braking)
        # The vehicle that the last candidate failed for is checked first, during the rollout.
        if not _roll(scene, target, dt, path, clause_workspace, suspect, reached):
            plans.margins[i] = -math.inf
            continue
        plan = PlannedPath(path, clause_workspace.turned, lane, fail)
        margin, clear, clause, vehicle = evaluate_path(plan, scene, hold, ignored, clause_workspace)
        plans.margins[i], plans.clear[i], plans.clauses[i], plans.vehicles[i] = margin, clear, clause, vehicle
        if margin >= 0 and found == NO_INDEX:
            found = i
            if first > 0:
                return found
        if first > 0 and clause == SEPARATION_BINDS and margin < 0 and hold == 0 and not behind[vehicle]:
            suspect, reached = vehicle, clear
            workspace.suspect[0], workspace.suspect[1] = vehicle, clear
    return found
