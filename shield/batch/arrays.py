"""Memory, records and workspace of the shields of many environments, as arrays.

They replace `shield.certificate.road.memory.Memory`, `shield.decision.Decision` and the objects of one decision, which
serve one environment.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, row_as_tuple
from dynamics.highway_simulator.arrays import Worlds
from dynamics.pass_by_pointer import Pointer
from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.traffic.occupancy import buffer_shape, horizons
from dynamics.traffic.rules_of_the_road import RoadRule
from dynamics.traffic.tables import bodies_of, motion_of
from dynamics.vehicle.bicycle import MAX_SPEED
from shield.batch.parameters import NO_INDEX, BatchParameters
from shield.certificate.road.clauses.clause_inputs import LaneState
from shield.certificate.road.clauses.footprint import Footprint
from shield.certificate.road.clauses.others import RoadVehicles, vehicles_from
from shield.certificate.road.clauses.parameters import settings_from
from shield.certificate.road.clauses.workspace import (
    ClauseScene,
    ClauseWorkspace,
    SceneVehicles,
    new_clause_workspace,
)

__all__ = [
    "BatchCandidates",
    "BatchMemory",
    "BatchPointers",
    "BatchRecords",
    "BatchWorkspace",
    "empty_memory",
    "empty_records",
    "new_batch_workspace",
    "scene_of",
    "without_precautions",
]

_ROWS, _STATES = 7, 4
_RULES = len(RoadRule)


class BatchMemory(NamedTuple):
    """Memory of e environments with m other bodies.

    The observation of the other bodies is kept for the last two scenes; `now` (e,) is the index of the later one.

    Attributes
    ----------
    frame : last observed frame, (e,); `NO_INDEX` before the first. clock : number of frames since the reset, (e,).
    stored : lane in which the stored fail-safe stops, (e,).
    ego, state : vehicle row (e, 7) and road state (e, 4). rows, states : of the others, (e, 2, m, 7), (e, 2, m, 4).
    marks, numbers, brakes, recent : of their `Tables`, (e, 2, ...).
    of_others, flags : of `RoadVehicles`, (e, 5, m) and (e, 2, 2 + 2 lanes, m).
    cutting_in, cut_ins : vehicles that may cut in, (e, 2 m, 4), and their number, (e,).
    visible, owned : state of the lanes, see `update_lanes`, (e, lanes).
    obliged, breaking, offenders : see `RoadMonitor`, (e, m). crashed : whether the ego had crashed, (e,).
    offences, by_rule : number of violations, (e,), and by rule, (e, rules).
    """

    frame: IntArray
    stored: IntArray
    clock: IntArray
    now: IntArray
    ego: FloatArray
    state: FloatArray
    rows: FloatArray
    states: FloatArray
    marks: IntArray
    numbers: FloatArray
    brakes: FloatArray
    recent: FloatArray
    of_others: FloatArray
    flags: BoolArray
    cutting_in: FloatArray
    cut_ins: IntArray
    visible: IntArray
    owned: BoolArray
    obliged: BoolArray
    breaking: BoolArray
    offenders: BoolArray
    crashed: BoolArray
    offences: IntArray
    by_rule: IntArray


class BatchCandidates(NamedTuple):
    """Candidates, and the results for each, (n,).

    Attributes
    ----------
    lanes, fails : lanes that each commits to and stops in. speeds : [m/s]. accelerations : [m/s^2].
    margins : [m]. clear : number of frames before the first negative separation.
    lawful : margin from the vehicles without a violation [m].
    expected, lasting : margin [m] and number of clear frames in the forecast.
    clauses, vehicles : binding clause and binding vehicle.
    """

    lanes: IntArray
    fails: IntArray
    speeds: FloatArray
    accelerations: FloatArray
    margins: FloatArray
    lawful: FloatArray
    expected: FloatArray
    clear: IntArray
    lasting: IntArray
    clauses: IntArray
    vehicles: IntArray


class BatchWorkspace(NamedTuple):
    """Workspace of one thread.

    Attributes
    ----------
    clause_workspace : workspace of the clauses. path : (K, 4). plans : candidates.
    ways, order : buffers of `dynamics.traffic.occupancy.derive_tables`, see `buffer_shape`.
    flags, tempted, marks, numbers, nobody, grid : buffers for masks, lanes, actions and accelerations.
    suspect : vehicle that the last candidate of this scene failed for, and the frame, (2,).
    """

    clause_workspace: ClauseWorkspace
    path: FloatArray
    plans: BatchCandidates
    ways: FloatArray
    order: IntArray
    flags: BoolArray
    tempted: BoolArray
    marks: IntArray
    numbers: FloatArray
    nobody: BoolArray
    grid: FloatArray
    suspect: IntArray


class BatchRecords(NamedTuple):
    """Records of the last decision, (e,), and of each of its F frames, (e, F).

    Attributes
    ----------
    broken : number of violations of each rule in the decision, (e, rules), in the order of `RoadRule`.
    tiers, reasons, clauses : indices of `TIERS`, `REASONS` and `CLAUSES` of `shield.batch.codes`; likewise `tier`,
        `reason` and `clause`.
    """

    proposed: IntArray
    executed: IntArray
    reason: IntArray
    tier: IntArray
    margin: FloatArray
    clause: IntArray
    vehicle: IntArray
    violations: IntArray
    broken: IntArray
    reasons: IntArray
    tiers: IntArray
    margins: FloatArray
    clauses: IntArray
    vehicles: IntArray
    lanes: IntArray
    accelerations: FloatArray


class BatchPointers(NamedTuple):
    """Pointers to everything that a decision reads and writes: the arrays of all environments, and of one thread."""

    shields: Pointer[BatchMemory]
    parameters: Pointer[BatchParameters]
    worlds: Pointer[Worlds]
    workspace: Pointer[BatchWorkspace]
    records: Pointer[BatchRecords]


@kernel_inline
def scene_of(shields: BatchMemory, parameters: BatchParameters, e: int) -> ClauseScene:
    """The last observed scene of one environment."""
    now = shields.now[e]
    marks, numbers, brakes = shields.marks[e, now], shields.numbers[e, now], shields.brakes[e, now]
    bodies = bodies_of(marks, numbers, brakes, shields.recent[e, now])
    others: RoadVehicles = vehicles_from(bodies, shields.of_others[e], shields.flags[e, now])
    rows, states = shields.rows[e, now], shields.states[e, now]
    around = SceneVehicles(rows, states, parameters.stretch, bodies, motion_of(parameters.motion), others)
    ground = LaneState(parameters.centers, shields.owned[e], shields.visible[e])
    cutting_in = shields.cutting_in[e, : shields.cut_ins[e]]
    foot, settings = Footprint(*row_as_tuple(parameters.size, 8)), settings_from(parameters.settings)
    return ClauseScene(shields.state[e], around, ground, cutting_in, foot, settings, parameters.table)


@kernel_inline
def without_precautions(scene: ClauseScene) -> ClauseScene:
    """The same without precautions, see `shield.certificate.road.verify.PathVerifier.without_cut_ins`."""
    none = scene.cutting_in[:0]
    return ClauseScene(scene.state, scene.around, scene.ground, none, scene.foot, scene.settings, scene.table)


def empty_memory(e: int, m: int, parameters: BatchParameters) -> BatchMemory:
    """Memory of e environments before their first scene."""
    lanes, (coming, past) = len(parameters.centers), horizons(parameters.numbers.dt)
    index, number, flag = np.intp, np.float64, np.bool_

    def new(kind: Any, *shape: int) -> Any:
        return np.zeros((e, *shape), kind)

    return BatchMemory(
        frame=new(index) + NO_INDEX,
        stored=new(index) + NO_INDEX,
        clock=new(index),
        now=new(index),
        ego=new(number, _ROWS),
        state=new(number, _STATES),
        rows=new(number, 2, m, _ROWS),
        states=new(number, 2, m, _STATES),
        marks=new(index, 2, 3, m),
        numbers=new(number, 2, 9, m),
        brakes=new(number, 2, m, coming),
        recent=new(number, 2, m, past),
        of_others=new(number, 5, m),
        flags=new(flag, 2, 2 + 2 * lanes, m),
        cutting_in=new(number, 2 * m, 4),
        cut_ins=new(index),
        visible=new(index, lanes),
        owned=new(flag, lanes),
        obliged=new(flag, m),
        breaking=new(flag, m),
        offenders=new(flag, m),
        crashed=new(flag),
        offences=new(index),
        by_rule=new(index, _RULES),
    )


def new_batch_workspace(m: int, parameters: BatchParameters, candidates: int) -> BatchWorkspace:
    """Workspace of one thread, for m other bodies and at most `candidates` candidates at a time."""
    numbers, lanes = parameters.numbers, len(parameters.centers)
    fastest = max(MAX_SPEED, float(parameters.target_speeds.max(initial=0.0))) + 10.0
    frames = numbers.period + math.ceil(fastest / (numbers.braking * numbers.dt)) + 2
    coming, _ = horizons(numbers.dt)
    n, index = candidates, np.intp
    plans = BatchCandidates(
        lanes=np.zeros(n, index),
        fails=np.zeros(n, index),
        speeds=np.zeros(n),
        accelerations=np.zeros(n),
        margins=np.zeros(n),
        lawful=np.zeros(n),
        expected=np.zeros(n),
        clear=np.zeros(n, index),
        lasting=np.zeros(n, index),
        clauses=np.zeros(n, index),
        vehicles=np.zeros(n, index),
    )
    return BatchWorkspace(
        clause_workspace=new_clause_workspace(m, frames, numbers.dt),
        path=np.zeros((frames, 4)),
        plans=plans,
        ways=np.zeros(buffer_shape(m, coming)),
        order=np.zeros(m, index),
        flags=np.zeros((2, m), np.bool_),
        tempted=np.zeros((m, 4), np.bool_),
        marks=np.zeros((6, max(lanes, len(parameters.labels), m)), index),
        numbers=np.zeros((2, max(len(parameters.labels), 1))),
        nobody=np.zeros(0, np.bool_),
        grid=np.zeros((3, candidates)),
        suspect=np.full(2, NO_INDEX),
    )


def empty_records(e: int, frames: int) -> BatchRecords:
    """Records for e environments and decisions of `frames` frames."""
    index = np.intp

    def one() -> IntArray:
        return np.zeros(e, index)

    def each() -> IntArray:
        return np.zeros((e, frames), index)

    return BatchRecords(
        proposed=one(),
        executed=one(),
        reason=one(),
        tier=one(),
        margin=np.zeros(e),
        clause=one(),
        vehicle=one(),
        violations=one(),
        broken=np.zeros((e, _RULES), index),
        reasons=each(),
        tiers=each(),
        margins=np.zeros((e, frames)),
        clauses=each(),
        vehicles=each(),
        lanes=each(),
        accelerations=np.zeros((e, frames)),
    )
