"""Shielded decisions in many environments, in one compiled call."""

from __future__ import annotations

import math
from typing import NamedTuple

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.arrays import Simulation
from dynamics.highway_simulator.layout import SPEED, TARGET, TARGET_SPEED
from dynamics.highway_simulator.neighbours import sort
from dynamics.highway_simulator.step_kernels import advance, begin, begin_next_episode, finish, write_rows
from dynamics.pass_by_pointer import address_of
from dynamics.state import BoolArray, FloatArray, IntArray
from shield.batch.arrays import BatchMemory, BatchPointers, BatchRecords, BatchWorkspace
from shield.batch.codes import TIERS
from shield.batch.deciding import decide, target_of
from shield.batch.observing import observe, reset_memory
from shield.batch.parameters import BatchParameters
from shield.batch.supervising import supervise
from shield.decision import Tier

__all__ = ["BatchPart", "DecisionInputs", "FrameRecords", "ShieldArrays", "let_pass", "step_all_shielded"]

_PASSED, _OFF = TIERS.index(Tier.PASSED), TIERS.index(Tier.OFF)
_NO_TARGET = -1, 0.0


class ShieldArrays(NamedTuple):
    """Memory, settings and records of the shields, and the workspace of one thread."""

    shields: BatchMemory
    parameters: BatchParameters
    workspace: BatchWorkspace
    records: BatchRecords


class DecisionInputs(NamedTuple):
    """Inputs of the decisions.

    Attributes
    ----------
    actions, orders : proposal in each environment, (e,), and order of the alternatives, (e, actions or 0), see
        `decide`.
    given : buffer for an action, (2,).
    """

    actions: IntArray
    orders: IntArray
    given: FloatArray


class FrameRecords(NamedTuple):
    """Bodies after each frame, (e, F, m, 7), and whether the ego is off the road then, (e, F)."""

    rows: FloatArray
    off_road: BoolArray


class BatchPart(NamedTuple):
    """The environments of one thread: from `first` to `last`; with `again`, environments with a finished episode are
    reset."""

    first: int
    last: int
    again: bool


@kernel_no_refcount
def let_pass(records: BatchRecords, e: int, proposed: int) -> None:
    """Record and execute the proposal without a shield."""
    records.proposed[e] = records.executed[e] = proposed
    records.tier[e], records.reason[e], records.margin[e] = _OFF, 0, math.nan
    records.clause[e], records.vehicle[e] = 0, -1
    for k in range(records.tiers.shape[1]):
        records.reasons[e, k], records.margins[e, k] = 0, math.nan
        records.clauses[e, k], records.vehicles[e, k] = 0, -1


@kernel_inline
def _repeat_decision(records: BatchRecords, e: int, lane: int) -> None:
    """Record the first frame of a passed decision, which has verified this frame with its target lane."""
    records.tiers[e, 0], records.reasons[e, 0], records.margins[e, 0] = _PASSED, 0, records.margin[e]
    records.clauses[e, 0], records.vehicles[e, 0] = records.clause[e], records.vehicle[e]
    records.lanes[e, 0], records.accelerations[e, 0] = lane, 0.0


@kernel_no_refcount
def step_all_shielded(
    simulation: Simulation,
    shield: ShieldArrays,
    inputs: DecisionInputs,
    frames: FrameRecords,
    part: BatchPart,
    frequency: float,
) -> None:
    """One shielded decision in each of the environments of a part.

    Parameters
    ----------
    shield : its memory and records are written. frames : written.
    frequency : frames per second [Hz].
    """
    machine, worlds, rules, view, work, seen = simulation
    shields, parameters, workspace, records = shield
    actions, orders, given = inputs
    pointers = BatchPointers(
        address_of(shields), address_of(parameters), address_of(worlds), address_of(workspace), address_of(records)
    )
    for e in range(part.first, part.last):
        before, proposed, off = shields.offences[e], actions[e], parameters.numbers.off
        broken, by_rule = records.broken[e], shields.by_rule[e]
        for k in range(by_rule.shape[0]):
            broken[k] = -by_rule[k]
        if off:
            let_pass(records, e, proposed)
        else:
            decide(pointers, e, proposed, orders[e])
        lane, speed = _NO_TARGET
        if records.tier[e] == _PASSED:
            lane, speed = target_of(worlds, parameters, e, proposed)
        given[0], given[1] = records.executed[e], 0.0
        begin(worlds, rules, e, given)
        level = sort(worlds.f[e], worlds.order[e])
        for k in range(rules.numbers[0]):
            throttle = math.nan
            if off:
                records.tiers[e, k] = _OFF
            elif k == 0 and lane == worlds.g[e, TARGET, 0] and speed == worlds.f[e, TARGET_SPEED, 0]:
                _repeat_decision(records, e, lane)
            else:
                supervise(pointers, e, k)
                if records.tiers[e, k] != _PASSED:
                    worlds.g[e, TARGET, 0] = records.lanes[e, k]
                    throttle = max(records.accelerations[e, k], -max(worlds.f[e, SPEED, 0], 0.0) * frequency)
            level = advance(machine, worlds, rules, work, e, level, (throttle, math.nan))
            shields.clock[e] += 1
            frames.off_road[e, k] = not write_rows(worlds, rules, e, frames.rows[e, k])
        finish(machine, worlds, rules, view, work, seen, e)
        if not off and (seen.terminated[e] or seen.truncated[e]):
            # The last frame of an episode is observed although no decision follows.
            observe(pointers, e)
        records.violations[e] = shields.offences[e] - before
        for k in range(by_rule.shape[0]):
            broken[k] += by_rule[k]
        if part.again and (seen.terminated[e] or seen.truncated[e]):
            begin_next_episode(machine, worlds, rules, view, work, seen, e)
            reset_memory(shields, e)
