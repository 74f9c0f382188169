"""One decision with simulated traffic: the executed action and the reason for it."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.layout import TARGET_SPEED
from dynamics.state import BoolArray, IntArray
from shield.batch.arrays import BatchRecords
from shield.batch.codes import REASONS, TIERS
from shield.certificate.simulated.closest import (
    best_plan,
    clear_plan,
    closest_plan,
    lane_speed_target_of,
    stopping_cost,
)
from shield.certificate.simulated.dead_ends import clear_dead_ends
from shield.certificate.simulated.node_budget import grant_last_budget
from shield.certificate.simulated.search import (
    PreferredActions,
    depth_first,
    find_sequence,
    same_outcome,
    set_root_scene,
)
from shield.certificate.simulated.traffic import ego_in
from shield.certificate.simulated.workspace import ANY, TrafficSearch
from shield.decision import Reason, Tier

__all__ = [
    "StoredSequences",
    "decide",
    "empty_plans",
    "has_no_certificate",
    "last_resort",
    "longest_sequence",
    "replace",
    "try_proposal",
    "verify",
]

_NONE, _UNVERIFIED, _NO_SAFE_PLAN, _BAD_ACTION = (
    REASONS.index(r) for r in (Reason.NONE, Reason.UNVERIFIED, Reason.NO_SAFE_PLAN, Reason.BAD_ACTION)
)
_PASSED, _ALTERNATIVE, _STORED, _LARGEST, _EMERGENCY = (
    TIERS.index(t) for t in (Tier.PASSED, Tier.ALTERNATIVE, Tier.STORED_PLAN, Tier.LARGEST_MARGIN, Tier.EMERGENCY)
)
_ANY_CLEARANCE = -1e9
"""Stands for a clearance that does not matter, as long as there is no crash [m]."""


class StoredSequences(NamedTuple):
    """The stored sequence of each environment.

    Attributes
    ----------
    actions : from the present on, (e, depth). length : number of them, (e,).
    verified : whether they keep the buffer; if not, no sequence was found that does, (e,).
    """

    actions: IntArray
    length: IntArray
    verified: BoolArray


def empty_plans(e: int, depth: int) -> StoredSequences:
    """The stored sequences before the first decision."""
    return StoredSequences(np.zeros((e, depth), np.intp), np.zeros(e, np.intp), np.ones(e, np.bool_))


@kernel_no_refcount
def _execute(
    records: BatchRecords, plans: StoredSequences, e: int, plan: IntArray, length: int, tier: int, reason: int
) -> None:
    """Execute the first action of a plan, and store the others."""
    records.executed[e], records.tier[e], records.reason[e] = plan[0], tier, reason
    for k in range(1, length):
        plans.actions[e, k - 1] = plan[k]
    plans.length[e] = max(length - 1, 0)
    if tier != _STORED:
        plans.verified[e] = tier != _LARGEST


@kernel_no_refcount
def last_resort(records: BatchRecords, plans: StoredSequences, e: int, slower: int, reason: int) -> None:
    """If no action can be judged: continue the stored sequence, or slow down; into `records`."""
    length, records.margin[e] = plans.length[e], math.nan
    if length > 0:
        _execute(records, plans, e, plans.actions[e], length, _STORED, reason)
    else:
        records.executed[e], records.tier[e], records.reason[e] = slower, _EMERGENCY, reason


@kernel_no_refcount
def verify(search: TrafficSearch, action: int, stored: IntArray, length: int, twice: bool) -> float:
    """Least clearance beyond the buffer of a sequence that begins with an action, into `search.plan` [m]; -inf if none
    is found that keeps the buffer for the whole horizon.

    The depth-first search comes first. With `twice`, on a straight highway, the search over lanes and speeds follows if
    the budget of the first was spent.
    """
    margin, exhausted = find_sequence(search, action, stored, length)
    if margin < 0 and exhausted and twice and search.bounds.straight:
        margin = clear_plan(search, action, ANY, stopping_cost(search))
    return margin


@kernel_no_refcount
def has_no_certificate(plans: StoredSequences, e: int) -> bool:
    """Whether the last decision found no sequence that keeps the buffer: then each action gets only one search."""
    return plans.length[e] > 0 and not plans.verified[e]


@kernel_inline
def _copy(source: IntArray, target: IntArray, length: int) -> None:
    for k in range(length):
        target[k] = source[k]


@kernel_no_refcount
def longest_sequence(search: TrafficSearch, stored: IntArray, length: int) -> tuple[int, float]:
    """The longest sequence without a crash, and among those for the whole horizon the one with the largest clearance
    found, into `search.plan`.

    The stored sequence is extended from its end. If the result is shorter than the horizon, a search over lanes and
    speeds follows, and its result is extended in the same way.

    Parameters
    ----------
    stored, length : the stored sequence, as in `depth_first`.

    Returns
    -------
    Number of decisions that the sequence lasts, and its least clearance beyond the buffer [m].
    """
    depth, lasts, margin = search.bounds.depth, 0, -np.inf
    grant_last_budget(search)
    if length > 0:
        preferred = PreferredActions(ANY, stored, length)
        lasts, margin, _ = depth_first(search, preferred, 0, _ANY_CLEARANCE, search.bounds.budget)
        _copy(search.plan, search.hint, lasts)
    if lasts < depth:
        further, clear = best_plan(search, ANY, ANY, depth, stopping_cost(search), _ANY_CLEARANCE)
        if further > lasts or (further == lasts and clear > margin):
            lasts, margin = further, clear
            _copy(search.plan, search.hint, lasts)
    if lasts < depth:
        # That search keeps one future for each lane and speed. The future with the largest clearance now may still be
        # hit later.
        clear_dead_ends(search)
        preferred = PreferredActions(ANY, search.hint, lasts)
        further, clear, _ = depth_first(search, preferred, 0, _ANY_CLEARANCE, search.bounds.budget)
        if further > lasts:
            return further, clear
    _copy(search.hint, search.plan, lasts)
    if lasts == 0:
        search.plan[0] = search.order[0]
    return lasts, margin


@kernel_no_refcount
def try_proposal(
    search: TrafficSearch, plans: StoredSequences, records: BatchRecords, worlds: Any, e: int, proposed: int
) -> bool:
    """Whether the decision is made by the proposal alone, into `records`: it verifies, or it is no valid action, so
    that the stored sequence or slowing down replaces it."""
    records.proposed[e], records.clause[e], records.vehicle[e] = proposed, 0, -1
    set_root_scene(search, worlds, e)
    if not 0 <= proposed < search.order.shape[0]:
        last_resort(records, plans, e, search.order[0], _BAD_ACTION)
        return True
    margin = verify(search, proposed, plans.actions[e], plans.length[e], not has_no_certificate(plans, e))
    if margin < 0:
        return False
    records.margin[e] = margin
    _execute(records, plans, e, search.plan, search.bounds.depth, _PASSED, _NONE)
    return True


@kernel_no_refcount
def replace(
    search: TrafficSearch, plans: StoredSequences, records: BatchRecords, e: int, proposed: int, order: IntArray
) -> None:
    """Choose and record the action that replaces a proposal that does not verify; see `decide`."""
    n, stored, length, margin = search.order.shape[0], plans.actions[e], plans.length[e], -np.inf
    ranked, now = order.shape[0] > 0 and order[0] >= 0, search.futures.f[0, TARGET_SPEED, ego_in(search, 0)]
    once, command = has_no_certificate(plans, e), lane_speed_target_of(search, now, proposed)
    if once and not ranked:
        margin, n = clear_plan(search, ANY, proposed, command), 0
    elif not ranked:
        margin = closest_plan(search, proposed, command)
    for k in range(n):
        if margin >= 0 or (ranked and (k >= order.shape[0] or order[k] < 0)):
            break
        action = order[k] if ranked else search.order[k]
        if action == proposed or same_outcome(search, action, proposed):
            continue
        if ranked:
            margin = verify(search, action, stored, length, not once)
        else:
            # The search over lanes and speeds has tried all actions already.
            margin, _ = find_sequence(search, action, stored, length)
    if margin < 0 and length > 0 and not once:
        # The stored sequence keeps the buffer to its end, from where it may be extended.
        grant_last_budget(search)
        margin, _ = find_sequence(search, ANY, stored, length)
    if margin < 0 and search.resting.margin[0] >= 0:
        margin = search.resting.margin[0]
        _copy(search.resting.plan, search.plan, search.bounds.depth)
    if margin >= 0:
        records.margin[e], passed = margin, search.plan[0] == proposed
        tier, reason = (_PASSED, _NONE) if passed else (_ALTERNATIVE, _UNVERIFIED)
        _execute(records, plans, e, search.plan, search.bounds.depth, tier, reason)
        return
    lasts, margin = longest_sequence(search, stored, length)
    records.margin[e] = margin if lasts == search.bounds.depth else math.nan
    _execute(records, plans, e, search.plan, lasts, _LARGEST, _NO_SAFE_PLAN)


@kernel_no_refcount
def decide(
    search: TrafficSearch,
    plans: StoredSequences,
    records: BatchRecords,
    worlds: Any,
    e: int,
    proposed: int,
    order: IntArray,
) -> None:
    """Decide about one proposal, into `records`.

    The proposal is executed if some sequence that begins with it keeps the buffer for the whole horizon. Otherwise the
    first alternative that does is executed, in the policy's order. Without an order, it is the one closest to where the
    proposal leads (`closest_plan`). If no action keeps the buffer, the longest sequence without a crash is executed;
    the next decision then uses one search for each action.

    Parameters
    ----------
    proposed : index of the action; if it is out of range, the stored sequence or slowing down replaces it.
    order : the policy's order of preference among the other actions, up to the first negative entry; may be empty.
    """
    if not try_proposal(search, plans, records, worlds, e, proposed):
        replace(search, plans, records, e, proposed, order)
