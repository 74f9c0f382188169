"""Decisions with simulated traffic in many environments, in one compiled call."""

from __future__ import annotations

import math

from dynamics.compiled import kernel_no_refcount
from dynamics.highway_simulator.arrays import ObservationConfig, StepResults, Worlds
from dynamics.highway_simulator.neighbours import sort
from dynamics.highway_simulator.step_kernels import advance, begin, begin_next_episode, finish, write_rows
from dynamics.state import BoolArray, FloatArray, IntArray
from shield.batch.arrays import BatchRecords
from shield.batch.codes import TIERS
from shield.certificate.simulated.decision_kernels import StoredSequences, decide
from shield.certificate.simulated.workspace import TrafficSearch
from shield.decision import Tier

__all__ = ["step_all_simulated"]

_OFF = TIERS.index(Tier.OFF)


@kernel_no_refcount
def step_all_simulated(
    search: TrafficSearch,
    worlds: Worlds,
    view: ObservationConfig,
    seen: StepResults,
    plans: StoredSequences,
    records: BatchRecords,
    actions: IntArray,
    orders: IntArray,
    rows: FloatArray,
    off_road: BoolArray,
    first: int,
    last: int,
    again: bool,
) -> None:
    """One decision in each of the environments from `first` to `last`; see `step_all_shielded`."""
    machine, rules, work = search.machine, search.rules, search.work
    for e in range(first, last):
        decide(search, plans, records, worlds, e, actions[e], orders[e])
        search.given[0], search.given[1] = records.executed[e], 0.0
        begin(worlds, rules, e, search.given)
        level = sort(worlds.f[e], worlds.order[e])
        for k in range(rules.numbers[0]):
            records.tiers[e, k], records.reasons[e, k], records.margins[e, k] = _OFF, 0, math.nan
            level = advance(machine, worlds, rules, work, e, level, math.nan, math.nan)
            off_road[e, k] = not write_rows(worlds, rules, e, rows[e, k])
        finish(machine, worlds, rules, view, work, seen, e)
        # The traffic is the one that was simulated, so it cannot deviate.
        records.violations[e] = 0
        if again and (seen.terminated[e] or seen.truncated[e]):
            begin_next_episode(machine, worlds, rules, view, work, seen, e)
            plans.length[e] = 0
