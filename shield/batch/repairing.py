"""Replacements for a frame that does not verify: `AccelerationCap` and the evasions of `shield.pipelines.frames`,
compiled."""

from __future__ import annotations

import math

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.pass_by_pointer import Pointer, dereference
from dynamics.roads.straight import nearest
from dynamics.state import IntArray
from dynamics.vehicle.controllers import KP_SPEED
from shield.batch.arrays import BatchMemory, BatchPointers, BatchWorkspace
from shield.batch.parameters import NO_INDEX, BatchParameters
from shield.batch.verifying import frames_of, verify
from shield.certificate.road.clauses.workspace import ClauseScene
from shield.pipelines.frames import ACCELERATIONS, GREATEST, LANE_PENALTY

__all__ = ["evade", "fail_lanes", "held_back", "hold_back"]


@kernel_inline
def _grid(parameters: BatchParameters, v: float, speed: float, workspace: BatchWorkspace) -> None:
    """Accelerations from full braking to that of the target, equal to `np.linspace` [m/s^2]."""
    low = -parameters.numbers.braking
    high = max(min(KP_SPEED * (speed - v), GREATEST), low)
    step = (high - low) / (ACCELERATIONS - 1)
    for i in range(ACCELERATIONS):
        workspace.grid[0, i] = i * step + low if step != 0 else i / (ACCELERATIONS - 1) * (high - low) + low
    workspace.grid[0, ACCELERATIONS - 1] = high


@kernel_inline
def held_back(parameters: BatchParameters, v: float, speed: float, change: float, workspace: BatchWorkspace) -> float:
    """Speed to which a target is reduced for one of `CAPS` [m/s]; see `capped_speeds`."""
    _grid(parameters, v, speed, workspace)
    place, tracking = 0, KP_SPEED * change
    for i in range(ACCELERATIONS):
        if workspace.grid[0, i] <= tracking:
            place = i
    return v + workspace.grid[0, place] / KP_SPEED


@kernel_inline
def fail_lanes(shields: BatchMemory, parameters: BatchParameters, e: int, lane: int, out: IntArray) -> int:
    """Fill in `shield.pipelines.frames.fail_lanes`. Return the number of lanes."""
    here, stored = nearest(parameters.centers, shields.state[e, 1]), shields.stored[e]
    if stored == NO_INDEX or abs(stored - here) > 1:
        stored = here
    out[0], n = lane, 1
    if here != lane:
        out[n] = here
        n += 1
    if stored not in (lane, here):
        out[n] = stored
        n += 1
    return n


@kernel_no_refcount
def hold_back(
    pointers: BatchPointers, scene: Pointer[ClauseScene], e: int, lane: int, speed: float, begins: int
) -> int:
    """The candidate with the greatest acceleration that verifies, committed lane first, or -1; `begins` as in
    `shield.pipelines.frames.AccelerationCap`, 0 or 1."""
    parameters, workspace = dereference(pointers.parameters), dereference(pointers.workspace)
    lanes, plans, grid = workspace.marks[2], workspace.plans, workspace.grid
    count, v = fail_lanes(dereference(pointers.shields), parameters, e, lane, lanes), dereference(scene).state[3]
    here = nearest(parameters.centers, dereference(scene).state[1])
    _grid(parameters, v, speed, workspace)
    most = -math.inf
    for i in range(ACCELERATIONS):
        grid[1, i] = v + grid[0, i] / KP_SPEED
        most = max(most, grid[1, i])
    frames = frames_of(parameters, v, most, parameters.numbers.one)
    # From the best score to the worst; among equals, by the lane of the stop, then by the target lane.
    nexts, tied, at = workspace.marks[3], workspace.marks[4], 0
    for k in range(count):
        nexts[k] = ACCELERATIONS - 1
    while True:
        best, n = -math.inf, 0
        for k in range(count):
            if nexts[k] >= 0:
                best = max(best, grid[0, nexts[k]] - (0.0 if lanes[k] == lane else LANE_PENALTY))
        if best == -math.inf:
            x = parameters.numbers
            return verify(pointers, scene, at, (x.one, frames), x.none, workspace.nobody, x.one)
        for k in range(count):
            if nexts[k] >= 0 and grid[0, nexts[k]] - (0.0 if lanes[k] == lane else LANE_PENALTY) == best:
                tied[n] = k
                n += 1
        for fail in range(count):
            for t in range(n):
                k = tied[t]
                if begins > 0 and k != fail and lanes[k] not in (lane, here):
                    continue
                plans.lanes[at], plans.fails[at] = lanes[k], lanes[fail]
                plans.accelerations[at], plans.speeds[at] = grid[0, nexts[k]], grid[1, nexts[k]]
                at += 1
        for t in range(n):
            nexts[tied[t]] -= 1


@kernel_inline
def _least_bad(workspace: BatchWorkspace, n: int, lawful: bool) -> int:
    """Index of the best candidate, among those that clear the vehicles without a violation (with `lawful`) or among
    all; see `shield.certificate.road.verify.least_bad_evasion`."""
    plans, best, most = workspace.plans, NO_INDEX, (0, 0, 0.0)
    for i in range(n):
        if lawful and not plans.lawful[i] >= 0:
            continue
        margin = -math.inf if math.isnan(plans.expected[i]) else plans.expected[i]
        found = (plans.lasting[i], plans.clear[i], margin)
        if best == NO_INDEX or found > most:
            best, most = i, found
    return best


@kernel_no_refcount
def evade(pointers: BatchPointers, scene_pointer: Pointer[ClauseScene], e: int, speed: float, violated: bool) -> int:
    """The candidate that is expected to stay clear longest, among those that clear the vehicles without a violation
    (see `ObservedScene.lawful`); if there are none, among all."""
    shields, parameters, workspace, scene = (
        dereference(pointers.shields),
        dereference(pointers.parameters),
        dereference(pointers.workspace),
        dereference(scene_pointer),
    )
    plans, lanes, x = workspace.plans, workspace.marks[2], parameters.numbers
    here, stored, n = nearest(parameters.centers, scene.state[1]), shields.stored[e], 0
    for lane in (here, here - 1, here + 1):
        if 0 <= lane < parameters.centers.shape[0]:
            lanes[n] = lane
            n += 1
    if stored != NO_INDEX and stored not in (here, here - 1, here + 1):
        lanes[n] = stored
        n += 1
    v, most = scene.state[3], -math.inf
    _grid(parameters, v, speed, workspace)
    at = 0
    for k in range(n):
        for i in range(ACCELERATIONS):
            plans.lanes[at] = plans.fails[at] = lanes[k]
            plans.accelerations[at], plans.speeds[at] = workspace.grid[0, i], v + workspace.grid[0, i] / KP_SPEED
            most = max(most, plans.speeds[at])
            at += 1
    frames = frames_of(parameters, v, most, parameters.numbers.one)
    if violated:
        verify(pointers, scene_pointer, at, (x.one, frames), x.none, shields.offenders[e], x.none)
        for i in range(at):
            plans.lawful[i] = plans.margins[i]
        # The workspace may hold the values of another forecast in this scene.
        for j in range(scene.around.states.shape[0]):
            workspace.clause_workspace.done[1, j] = 0
        verify(pointers, scene_pointer, at, (x.one, frames), frames, workspace.nobody, x.none)
        for i in range(at):
            plans.expected[i], plans.lasting[i] = plans.margins[i], plans.clear[i]
    verify(pointers, scene_pointer, at, (x.one, frames), x.none, workspace.nobody, x.none)
    keeps = False
    for i in range(at):
        if not violated:
            plans.lawful[i] = plans.expected[i] = plans.margins[i]
            plans.lasting[i] = plans.clear[i]
        keeps = keeps or plans.lawful[i] >= 0
    return _least_bad(workspace, at, keeps)
