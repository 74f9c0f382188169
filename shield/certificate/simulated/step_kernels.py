"""Decisions with simulated traffic in many environments, in one compiled call."""

from __future__ import annotations

import math
from typing import NamedTuple

from dynamics.compiled import kernel_no_refcount
from dynamics.highway_simulator.arrays import ObservationConfig, StepResults, Worlds
from dynamics.highway_simulator.neighbours import sort
from dynamics.highway_simulator.step_kernels import NO_INPUTS, advance, begin, begin_next_episode, finish, write_rows
from shield.batch.arrays import BatchRecords
from shield.batch.codes import TIERS
from shield.batch.step_kernels import BatchPart, DecisionInputs, FrameRecords
from shield.certificate.simulated.decision_kernels import StoredSequences, decide
from shield.certificate.simulated.workspace import TrafficSearch
from shield.decision import Tier

__all__ = ["SimulatedShields", "step_all_simulated"]

_OFF = TIERS.index(Tier.OFF)


class SimulatedShields(NamedTuple):
    """Workspace of one thread, and stored sequences and records of all environments."""

    search: TrafficSearch
    plans: StoredSequences
    records: BatchRecords


@kernel_no_refcount
def step_all_simulated(
    shield: SimulatedShields,
    worlds: Worlds,
    view: ObservationConfig,
    seen: StepResults,
    inputs: DecisionInputs,
    frames: FrameRecords,
    part: BatchPart,
) -> None:
    """One decision in each of the environments of a part; see `step_all_shielded`."""
    search, plans, records = shield
    machine, rules, work = search.machine, search.rules, search.work
    for e in range(part.first, part.last):
        decide(search, plans, records, worlds, e, inputs.actions[e], inputs.orders[e])
        inputs.given[0], inputs.given[1] = records.executed[e], 0.0
        begin(worlds, rules, e, inputs.given)
        level = sort(worlds.f[e], worlds.order[e])
        for k in range(rules.numbers[0]):
            records.tiers[e, k], records.reasons[e, k], records.margins[e, k] = _OFF, 0, math.nan
            level = advance(machine, worlds, rules, work, e, level, NO_INPUTS)
            frames.off_road[e, k] = not write_rows(worlds, rules, e, frames.rows[e, k])
        finish(machine, worlds, rules, view, work, seen, e)
        # The traffic is the one that was simulated, so it cannot deviate.
        records.violations[e] = 0
        if part.again and (seen.terminated[e] or seen.truncated[e]):
            begin_next_episode(machine, worlds, rules, view, work, seen, e)
            plans.length[e] = 0
