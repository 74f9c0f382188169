"""Observation of the scene of one of many environments: `memory.observe` and `RoadMonitor.next` of the certificate,
compiled."""

from __future__ import annotations

import math

from dynamics.compiled import kernel_inline, kernel_no_refcount, row_as_tuple
from dynamics.highway_simulator.layout import TARGET_SPEED
from dynamics.highway_simulator.step_kernels import Worlds, write_row
from dynamics.pass_by_pointer import address_of, dereference
from dynamics.roads.straight import nearest
from dynamics.state import FloatArray
from dynamics.traffic.occupancy import derive_tables
from dynamics.traffic.rules_of_the_road import EgoFootprint, RoadRule, check_motions
from dynamics.traffic.tables import bodies_of
from dynamics.vehicle.controllers import KP_SPEED
from shield.batch.arrays import BatchMemory, BatchPointers, BatchWorkspace, scene_of
from shield.batch.parameters import NO_INDEX, BatchParameters
from shield.batch.verifying import frames_of, verify
from shield.certificate.road.clauses.followers import mark_relied_on, update_lanes
from shield.certificate.road.clauses.footprint import Footprint
from shield.certificate.road.clauses.others import TOUCH, vehicles_from
from shield.certificate.road.clauses.scene import prepare_scene
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
def set_stop_candidate(shields: BatchMemory, law: BatchParameters, e: int, lane: int, room: BatchWorkspace) -> int:
    """Set candidate 0 to braking to a stop in a lane from now on. Return its number of frames."""
    plans, numbers, v = room.plans, law.numbers, shields.state[e, 3]
    plans.lanes[0], plans.fails[0], plans.speeds[0] = lane, lane, v - numbers.braking / KP_SPEED
    return frames_of(law, v, plans.speeds[0], numbers.one)


@kernel_no_refcount
def observe(bench: BatchPointers, e: int) -> bool:
    """Observe the scene of one environment, once a frame. Return False, and change nothing, if it is not finite."""
    shields, law, worlds, room = (
        dereference(bench.shields),
        dereference(bench.law),
        dereference(bench.worlds),
        dereference(bench.room),
    )
    if shields.frame[e] == shields.clock[e]:
        return True
    old = shields.now[e]
    new, first = 1 - old, shields.frame[e] == NO_INDEX
    rows, states, ego, state = shields.rows[e, new], shields.states[e, new], shields.ego[e], shields.state[e]
    m, lanes, numbers, centers = rows.shape[0], law.centers.shape[0], law.numbers, law.centers
    finite = math.isfinite(worlds.f[e, TARGET_SPEED, 0]) and _row(worlds, e, 0, ego, state)
    for i in range(m):
        finite = _row(worlds, e, i + 1, rows[i], states[i]) and finite
    if not finite:
        return False
    known = 0 if first else m
    marks, tables, brakes, recent = (
        shields.marks[e, new],
        shields.numbers[e, new],
        shields.brakes[e, new],
        shields.recent[e, new],
    )
    rows0, states0, tables0, recent0 = (
        shields.rows[e, old],
        shields.states[e, old],
        shields.numbers[e, old],
        shields.recent[e, old],
    )
    # The lanes that the ego owns, and the vehicles that may enter each lane.
    coming = shields.flags[e, old, 2 + lanes : 2 + lanes if first else 2 + 2 * lanes]
    half = 0.5 * (ego[4] * abs(math.sin(state[2])) + ego[5] * abs(math.cos(state[2])))
    touch, leave = TOUCH + half, 0.5 * numbers.width + half
    visible, owned, stored = shields.visible[e], shields.owned[e], shields.stored[e]
    update_lanes(
        state[1], centers, 1, law.settings[0], touch, leave, stored, first, visible, owned, shields.owing[e], coming
    )
    derive_tables(
        rows,
        states,
        law.growth,
        law.stretch,
        centers,
        numbers.width,
        law.motion,
        0.0,
        state[0],
        states0[:known],
        tables0,
        recent0,
        marks,
        tables,
        brakes,
        recent,
        room.order,
        room.ways,
    )
    flags = shields.flags[e, new]
    shields.slips[e] = prepare_scene(
        rows,
        states,
        marks,
        tables,
        brakes,
        recent,
        ego,
        state,
        law.size,
        centers,
        law.settings,
        owned,
        visible,
        (stored, NO_INDEX),
        shields.owing[e, :known],
        coming,
        shields.of_others[e],
        flags,
        shields.slipping[e],
        room.tempted,
    )
    shields.now[e], shields.frame[e] = new, shields.clock[e]
    room.desk.swept[0], room.suspect[0] = 0, NO_INDEX
    for j in range(m):
        room.desk.done[0, j] = room.desk.done[1, j] = 0
    crashed = ego[6] > 0
    if first:
        for i in range(m):
            shields.owing[e, i] = flags[0, i] and flags[1, i]
            shields.breaking[e, i] = shields.offenders[e, i] = False
        shields.crashed[e] = crashed
        return True
    along, across = 0.5 * ego[4], 0.5 * ego[5]
    world = EgoFootprint(
        ego[0],
        ego[1],
        ego[2],
        ego[3],
        along + numbers.longitudinal,
        across + numbers.lateral,
        along,
        across,
        crashed and not shields.crashed[e],
        crashed,
    )
    broken, grown, owing = room.marks[0, :m], room.marks[1, :m], room.flags[0]
    check_motions(
        rows0,
        states0,
        shields.marks[e, old],
        tables0,
        shields.brakes[e, old],
        recent0,
        rows,
        states,
        marks,
        tables,
        brakes,
        recent,
        law.stretch,
        law.motion,
        shields.owing[e],
        world,
        law.limits,
        broken,
        grown,
    )
    counted, flags0 = room.flags[1], shields.flags[e, old]
    for i in range(m):
        counted[i] = False
    if stored != NO_INDEX:
        others = vehicles_from(bodies_of(marks, tables, brakes, recent), shields.of_others[e], flags)
        foot, plan, followers = Footprint(*row_as_tuple(law.size, 8)), (stored, NO_INDEX), (flags0[0], flags0[1])
        mark_relied_on(others, state, foot, centers, plan, owned, followers, counted)
    some, more = update_obligations(shields.owing[e], counted, flags[0], flags[1], broken, grown, owing)
    if more:
        # A vehicle that takes more room than before has to leave the ego's fail-safe its room.
        some = mark_touching(world, rows, numbers.dt, grown, broken) or some
        frames = set_stop_candidate(shields, law, e, nearest(centers, state[1]) if stored == NO_INDEX else stored, room)
        scene, one, none = address_of(scene_of(shields, law, e)), numbers.one, numbers.none
        verify(bench, scene, one, one, frames, none, room.nobody, none)
        for n in range(room.desk.found[0]):
            j = room.desk.near[n]
            if room.desk.apart[n] < 0:
                broken[j] |= grown[j]
                some = some or broken[j] != 0
    for i in range(m):
        shields.owing[e, i] = owing[i]
        if some and broken[i] != 0:
            if not shields.breaking[e, i]:
                shields.offences[e] += 1
                for k in range(_RULES):
                    if broken[i] & (1 << k):
                        shields.by_rule[e, k] += 1
            shields.offenders[e, i] = True
        shields.breaking[e, i] = broken[i] != 0
    shields.crashed[e] = crashed
    return True
