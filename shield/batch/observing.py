"""Observation of the scene of one of many environments: `memory.observe` and `RoadMonitor.next` of the certificate,
compiled."""

from __future__ import annotations

import math

from dynamics.compiled import kernel_inline, kernel_no_refcount, row_as_tuple
from dynamics.highway_simulator.arrays import Worlds
from dynamics.highway_simulator.layout import TARGET_SPEED
from dynamics.highway_simulator.step_kernels import write_row
from dynamics.pass_by_pointer import address_of, dereference
from dynamics.roads.straight import nearest
from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.traffic.motion_limits import MotionLimits
from dynamics.traffic.occupancy import PreviousTables, VehiclesOnRoad, derive_tables
from dynamics.traffic.occupancy_kernels import LaneMarkings
from dynamics.traffic.reaction import LapPosition, ReactionWork
from dynamics.traffic.rules_of_the_road import EgoFootprint, RoadRule, RuleViolations, check_motions
from dynamics.traffic.tables import Tables, VehicleTables, bodies_of
from dynamics.vehicle.controllers import KP_SPEED
from shield.batch.arrays import BatchMemory, BatchPointers, BatchWorkspace, scene_of
from shield.batch.parameters import NO_INDEX, BatchParameters
from shield.batch.verifying import frames_of, verify
from shield.certificate.road.clauses.clause_inputs import EarlierVehicles, EgoArrays, LaneDistances, LaneState
from shield.certificate.road.clauses.followers import mark_relied_on, update_lanes
from shield.certificate.road.clauses.footprint import Footprint
from shield.certificate.road.clauses.others import TOUCH, VehicleBuffers, vehicles_from
from shield.certificate.road.clauses.scene import SceneBuffers, prepare_scene
from shield.certificate.road.monitor import mark_touching, update_obligations

__all__ = ["observe", "reset_memory", "set_stop_candidate"]

_RULES = len(RoadRule)


@kernel_inline
def _row(worlds: Worlds, e: int, i: int, row: FloatArray, state: FloatArray) -> bool:
    """Write a body as a vehicle row and, on a straight road along x, as a road state. Return whether all its numbers
    are finite."""
    write_row(worlds.f[e], worlds.g[e], worlds.p[e], i, row)
    state[0], state[1], state[2], state[3] = row[0], row[1], row[2], row[3]
    return math.isfinite(row[0] + row[1] + row[2] + row[3] + row[4] + row[5])


@kernel_no_refcount
def reset_memory(shields: BatchMemory, e: int) -> None:
    """Reset the memory of one environment for a new episode."""
    shields.frame[e] = shields.stored[e] = NO_INDEX
    shields.clock[e] = shields.offences[e] = 0
    shields.crashed[e] = False
    for k in range(_RULES):
        shields.by_rule[e, k] = 0


@kernel_inline
def set_stop_candidate(
    shields: BatchMemory, parameters: BatchParameters, e: int, lane: int, workspace: BatchWorkspace
) -> int:
    """Set candidate 0 to braking to a stop in a lane from now on. Return its number of frames."""
    plans, numbers, v = workspace.plans, parameters.numbers, shields.state[e, 3]
    plans.lanes[0], plans.fails[0], plans.speeds[0] = lane, lane, v - numbers.braking / KP_SPEED
    return frames_of(parameters, v, plans.speeds[0], numbers.one)


@kernel_inline
def _tables(shields: BatchMemory, e: int, scene: int) -> VehicleTables:
    """The other vehicles in one of the two scenes that are kept."""
    tables = Tables(
        shields.marks[e, scene], shields.numbers[e, scene], shields.brakes[e, scene], shields.recent[e, scene]
    )
    return VehicleTables(shields.rows[e, scene], shields.states[e, scene], tables)


@kernel_inline
def _read(worlds: Worlds, e: int, shields: BatchMemory, after: VehicleTables) -> bool:
    """Write the bodies of one environment to its memory. Return whether the scene is finite."""
    finite = math.isfinite(worlds.f[e, TARGET_SPEED, 0]) and _row(worlds, e, 0, shields.ego[e], shields.state[e])
    for i in range(after.others.shape[0]):
        finite = _row(worlds, e, i + 1, after.others[i], after.states[i]) and finite
    return finite


@kernel_inline
def _prepare(
    shields: BatchMemory,
    parameters: BatchParameters,
    e: int,
    workspace: BatchWorkspace,
    before: VehicleTables,
    after: VehicleTables,
) -> None:
    """Prepare the new scene: the lanes that the ego owns, the tables of the vehicles, and what the clauses read."""
    old, new, first = shields.now[e], 1 - shields.now[e], shields.frame[e] == NO_INDEX
    ego, state, m, lanes, numbers = (
        shields.ego[e],
        shields.state[e],
        after.others.shape[0],
        parameters.centers.shape[0],
        parameters.numbers,
    )
    known = 0 if first else m
    # The lanes that the ego owns, and the vehicles that may enter each lane.
    coming = shields.flags[e, old, 2 + lanes : 2 + lanes if first else 2 + 2 * lanes]
    half = 0.5 * (ego[4] * abs(math.sin(state[2])) + ego[5] * abs(math.cos(state[2])))
    near = LaneDistances(parameters.settings[0], TOUCH + half, 0.5 * numbers.width + half)
    ground, stored = LaneState(parameters.centers, shields.owned[e], shields.visible[e]), shields.stored[e]
    update_lanes(state[1], 1, near, (stored, first), ground, shields.obliged[e], coming)
    motion = parameters.motion
    markings = LaneMarkings(parameters.centers, numbers.width, motion[17], motion[18], motion[16])
    vehicles = VehiclesOnRoad(after.others, after.states, parameters.growth, parameters.stretch)
    last = PreviousTables(before.states[:known], before.tables.numbers, before.tables.recent)
    work, place = ReactionWork(workspace.order, workspace.ways), LapPosition(0.0, state[0])
    derive_tables(vehicles, markings, motion, place, last, after.tables, work)
    out = SceneBuffers(
        VehicleBuffers(shields.of_others[e], shields.flags[e, new]), shields.cutting_in[e], workspace.tempted
    )
    earlier, row = EarlierVehicles(shields.obliged[e, :known], coming), EgoArrays(ego, state, parameters.size)
    shields.cut_ins[e] = prepare_scene(after, row, ground, parameters.settings, (stored, NO_INDEX), earlier, out)
    shields.now[e], shields.frame[e] = new, shields.clock[e]
    workspace.clause_workspace.swept[0], workspace.suspect[0] = 0, NO_INDEX
    for j in range(m):
        workspace.clause_workspace.done[0, j] = workspace.clause_workspace.done[1, j] = 0


@kernel_inline
def _world(shields: BatchMemory, parameters: BatchParameters, e: int) -> EgoFootprint:
    """The ego of one environment in the world frame."""
    ego, numbers, crashed = shields.ego[e], parameters.numbers, shields.ego[e, 6] > 0
    along, across = 0.5 * ego[4], 0.5 * ego[5]
    longitudinal, lateral = along + numbers.longitudinal, across + numbers.lateral
    new = crashed and not shields.crashed[e]
    return EgoFootprint(ego[0], ego[1], ego[2], ego[3], longitudinal, lateral, along, across, new, crashed)


@kernel_inline
def _mark_relied_on(
    shields: BatchMemory, parameters: BatchParameters, e: int, after: VehicleTables, counted: BoolArray
) -> None:
    """`mark_relied_on` in one environment, after `_prepare`."""
    for i in range(counted.shape[0]):
        counted[i] = False
    if shields.stored[e] == NO_INDEX:
        return
    tables, flags, flags0 = after.tables, shields.flags[e, shields.now[e]], shields.flags[e, 1 - shields.now[e]]
    bodies = bodies_of(tables.marks, tables.numbers, tables.brakes, tables.recent)
    others, foot = vehicles_from(bodies, shields.of_others[e], flags), Footprint(*row_as_tuple(parameters.size, 8))
    lanes, plan = LaneState(parameters.centers, shields.owned[e], shields.visible[e]), (shields.stored[e], NO_INDEX)
    mark_relied_on(others, shields.state[e], foot, lanes, plan, (flags0[0], flags0[1]), counted)


@kernel_inline
def _mark_growth(pointers: BatchPointers, e: int, broken: IntArray, grown: IntArray) -> bool:
    """Add `grown` to `broken` where the fail-safe loses its room. Return whether there is any such vehicle."""
    shields, parameters, workspace = (
        dereference(pointers.shields),
        dereference(pointers.parameters),
        dereference(pointers.workspace),
    )
    stored, some = shields.stored[e], False
    lane = nearest(parameters.centers, shields.state[e, 1]) if stored == NO_INDEX else stored
    frames = set_stop_candidate(shields, parameters, e, lane, workspace)
    scene, one, none = address_of(scene_of(shields, parameters, e)), parameters.numbers.one, parameters.numbers.none
    verify(pointers, scene, one, (one, frames), none, workspace.nobody, none)
    for n in range(workspace.clause_workspace.found[0]):
        j = workspace.clause_workspace.near[n]
        if workspace.clause_workspace.apart[n] < 0:
            broken[j] |= grown[j]
            some = some or broken[j] != 0
    return some


@kernel_inline
def _count(shields: BatchMemory, e: int, obliged: BoolArray, broken: IntArray, some: bool) -> None:
    """Store the distance obligations, and count the violations. With `some`, there are new ones or ones that last."""
    for i in range(broken.shape[0]):
        shields.obliged[e, i] = obliged[i]
        if some and broken[i] != 0:
            if not shields.breaking[e, i]:
                shields.offences[e] += 1
                for k in range(_RULES):
                    if broken[i] & (1 << k):
                        shields.by_rule[e, k] += 1
            shields.offenders[e, i] = True
        shields.breaking[e, i] = broken[i] != 0


@kernel_no_refcount
def observe(pointers: BatchPointers, e: int) -> bool:
    """Observe the scene of one environment, once a frame. Return False, and change nothing, if it is not finite."""
    shields, parameters, workspace = (
        dereference(pointers.shields),
        dereference(pointers.parameters),
        dereference(pointers.workspace),
    )
    if shields.frame[e] == shields.clock[e]:
        return True
    old, first = shields.now[e], shields.frame[e] == NO_INDEX
    before, after = _tables(shields, e, old), _tables(shields, e, 1 - old)
    if not _read(dereference(pointers.worlds), e, shields, after):
        return False
    _prepare(shields, parameters, e, workspace, before, after)
    m, flags, crashed = after.others.shape[0], shields.flags[e, 1 - old], shields.ego[e, 6] > 0
    if first:
        for i in range(m):
            shields.obliged[e, i] = flags[0, i] and flags[1, i]
            shields.breaking[e, i] = shields.offenders[e, i] = False
        shields.crashed[e] = crashed
        return True
    world, limits = (
        _world(shields, parameters, e),
        MotionLimits(parameters.stretch, parameters.motion, parameters.limits),
    )
    broken, grown, obliged, counted = (
        workspace.marks[0, :m],
        workspace.marks[1, :m],
        workspace.flags[0],
        workspace.flags[1],
    )
    check_motions(before, after, limits, shields.obliged[e], world, RuleViolations(broken, grown))
    _mark_relied_on(shields, parameters, e, after, counted)
    some, more = update_obligations(shields.obliged[e], counted, flags[0], flags[1], broken, grown, obliged)
    if more:
        # A vehicle that takes more room than before has to leave the ego's fail-safe its room.
        some = mark_touching(world, after.others, parameters.numbers.dt, grown, broken) or some
        some = _mark_growth(pointers, e, broken, grown) or some
    _count(shields, e, obliged, broken, some)
    shields.crashed[e] = crashed
    return True
