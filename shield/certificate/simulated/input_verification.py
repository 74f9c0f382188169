"""Verifies one frame of throttle and steering by simulation: after it, a backup controller has to keep the buffer.

The backup controller consists of highway-env's lane and speed controllers. The search for its sequence of target lanes
and speeds is that for meta-actions (`search`). An input verifies if, after one frame of it, some sequence keeps the
buffer for the whole horizon. This sequence is stored and can be executed from the next frame on, so there is always a
fallback.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.layout import ACCELERATION, CRASHED, STEERING
from dynamics.state import FloatArray, IntArray
from shield.batch.codes import TIERS
from shield.certificate.simulated.closest import clear_plan, stopping_cost
from shield.certificate.simulated.decision_kernels import longest_sequence
from shield.certificate.simulated.search import clearance, find_sequence, set_root
from shield.certificate.simulated.traffic import ego_in, frame, hold, on_road, sorted_in, start
from shield.certificate.simulated.workspace import ANY, TrafficSearch
from shield.decision import Tier

__all__ = ["BackupSequence", "advance_backup", "decide_inputs", "empty_tail"]

_PASSED, _GOVERNED, _STORED, _ALTERNATIVE, _LARGEST = (
    TIERS.index(t) for t in (Tier.PASSED, Tier.GOVERNED, Tier.STORED_PLAN, Tier.ALTERNATIVE, Tier.LARGEST_MARGIN)
)
_THROTTLE, _WHEEL, _NEITHER = range(3)
_HALVINGS = 3
"""Number of bisections between the backup controller's input and the proposal."""


class BackupSequence(NamedTuple):
    """The stored sequence of the backup controller.

    Attributes
    ----------
    actions : target lanes and speeds, as meta-actions, (depth,).
    counts : number of remaining actions, and remaining frames of the action that has begun, (2,).
    """

    actions: IntArray
    counts: IntArray


def empty_tail(depth: int) -> BackupSequence:
    """The stored sequence before the first decision of an episode."""
    return BackupSequence(np.zeros(depth, np.intp), np.zeros(2, np.intp))


@kernel_no_refcount
def _store(search: TrafficSearch, tail: BackupSequence, length: int) -> None:
    for k in range(length):
        tail.actions[k] = search.plan[k]
    tail.counts[0], tail.counts[1] = length, 0


@kernel_no_refcount
def _goes_on(search: TrafficSearch, tail: BackupSequence) -> float:
    """Search for a continuation of the backup controller from future 0, into `search.plan`. The stored sequence,
    stopping, keeping the speed, speeding up, and sequences close to these are tried.

    Stopping is tried first: an ego that stands at the end is clear beyond the horizon. Return the least clearance
    beyond the buffer [m], -inf if none stays clear.
    """
    depth, n, stops = search.bounds.depth, search.order.shape[0], True
    for i in range(tail.counts[0]):
        stops = stops and tail.actions[i] == search.order[0]
    for k in range(-1, 3):
        length, first = tail.counts[0], tail.actions[0]
        if k != 0:
            # The order begins with slowing down and keeping the speed, and ends with speeding up.
            length, first = depth, search.order[0 if k < 0 else 1 if k == 1 else n - 1]
            for i in range(depth):
                search.hint[i] = first
        elif stops:
            continue
        margin, _ = find_sequence(search, first, search.hint if k != 0 else tail.actions, length)
        if margin >= 0:
            return margin
    return -np.inf


@kernel_no_refcount
def _after(search: TrafficSearch, present: TrafficSearch, tail: BackupSequence, throttle: float, wheel: float) -> float:
    """Least clearance beyond the buffer of one frame of an input and the best continuation of the backup controller,
    into `search.plan` [m]; -inf if none stays clear.

    Parameters
    ----------
    throttle, wheel : acceleration [m/s^2] and front wheel angle [rad].
    """
    futures = search.futures
    set_root(search, present.futures, 0)
    hold(search, 0, throttle, wheel)
    frame(search, 0, sorted_in(search, 0))
    ego = ego_in(search, 0)
    on, turns_back = on_road(search, 0)
    if futures.g[0, CRASHED, ego] != 0 or not on:
        return -np.inf
    least = clearance(futures, 0, ego, search.bounds, search.row)
    if turns_back or least < 0:
        return least if least >= 0 else -np.inf
    return min(least, _goes_on(search, tail))


@kernel_no_refcount
def advance_backup(present: TrafficSearch, tail: BackupSequence, inputs: FloatArray) -> None:
    """Advance the present by one frame of the backup controller. Its acceleration [m/s^2] and front wheel angle [rad]
    are written to `inputs`, (2,)."""
    futures, actions, counts = present.futures, tail.actions, tail.counts
    if counts[1] == 0 and counts[0] > 0:
        present.given[0], present.given[1] = actions[0], 0.0
        start(present, 0)
        counts[0], counts[1] = counts[0] - 1, present.rules.numbers[0]
        for k in range(counts[0]):
            actions[k] = actions[k + 1]
    frame(present, 0, sorted_in(present, 0))
    counts[1] = max(counts[1] - 1, 0)
    ego = ego_in(present, 0)
    inputs[0], inputs[1] = futures.f[0, ACCELERATION, ego], futures.f[0, STEERING, ego]


@kernel_no_refcount
def _take(present: TrafficSearch, inputs: FloatArray, throttle: float, wheel: float) -> None:
    """Advance the present by one frame of an input, and write it to `inputs`."""
    hold(present, 0, throttle, wheel)
    frame(present, 0, sorted_in(present, 0))
    inputs[0], inputs[1] = throttle, wheel


@kernel_no_refcount
def _peek(search: TrafficSearch, present: TrafficSearch, tail: BackupSequence, inputs: FloatArray) -> None:
    """Write the next acceleration [m/s^2] and front wheel angle [rad] of the backup controller to `inputs`, without
    advancing the present."""
    futures = search.futures
    set_root(search, present.futures, 0)
    if tail.counts[1] == 0 and tail.counts[0] > 0:
        search.given[0], search.given[1] = tail.actions[0], 0.0
        start(search, 0)
    frame(search, 0, sorted_in(search, 0))
    ego = ego_in(search, 0)
    inputs[0], inputs[1] = futures.f[0, ACCELERATION, ego], futures.f[0, STEERING, ego]


@kernel_no_refcount
def _anew(search: TrafficSearch, present: TrafficSearch, tail: BackupSequence) -> tuple[int, float]:
    """Find and store a new sequence: one that keeps the buffer, otherwise the one that lasts longest. Return the tier,
    and the least clearance beyond the buffer [m]."""
    depth = search.bounds.depth
    set_root(search, present.futures, 0)
    for k in range(search.order.shape[0]):
        margin, _ = find_sequence(search, search.order[k], tail.actions, 0)
        if margin >= 0:
            _store(search, tail, depth)
            return _ALTERNATIVE, margin
    margin = clear_plan(search, ANY, ANY, stopping_cost(search))
    if margin >= 0:
        _store(search, tail, depth)
        return _ALTERNATIVE, margin
    length, margin = longest_sequence(search, tail.actions, 0)
    _store(search, tail, max(length, 1))
    return _LARGEST, margin


@kernel_inline
def _between(proposal: FloatArray, inputs: FloatArray, kept: int, share: float) -> tuple[float, float]:
    """Input at `share` of the distance from the backup controller's input to the proposal; the component `kept` is that
    of the proposal."""
    throttle = inputs[0] + (1.0 if kept == _THROTTLE else share) * (proposal[0] - inputs[0])
    return throttle, inputs[1] + (1.0 if kept == _WHEEL else share) * (proposal[1] - inputs[1])


@kernel_no_refcount
def _nearest(
    search: TrafficSearch,
    present: TrafficSearch,
    tail: BackupSequence,
    proposal: FloatArray,
    inputs: FloatArray,
    kept: int,
) -> tuple[float, float]:
    """Bisect between the backup controller's input and the proposal for the nearest input that verifies, with the
    component `kept` from the proposal. The sequence that follows it is stored.

    Returns
    -------
    Share of the distance to the proposal, negative if no input verifies; and least clearance beyond the buffer [m].
    """
    best, margin, share, width = -1.0, -np.inf, 0.5, 0.25
    if kept != _NEITHER:
        throttle, wheel = _between(proposal, inputs, kept, 0.0)
        margin = _after(search, present, tail, throttle, wheel)
        if margin < 0:
            return -1.0, margin
        best = 0.0
        _store(search, tail, search.bounds.depth)
    for _ in range(_HALVINGS):
        throttle, wheel = _between(proposal, inputs, kept, share)
        found = _after(search, present, tail, throttle, wheel)
        if found >= 0:
            best, margin = share, found
            _store(search, tail, search.bounds.depth)
        share, width = share + (width if found >= 0 else -width), width / 2
    return best, margin


@kernel_no_refcount
def decide_inputs(
    search: TrafficSearch,
    present: TrafficSearch,
    tail: BackupSequence,
    proposal: FloatArray,
    known: bool,
    inputs: FloatArray,
) -> tuple[int, float]:
    """Decide about one frame, and advance the present by it.

    The proposal is executed if the backup controller keeps the buffer after it. Otherwise it is moved towards the
    backup controller's input, by the least amount that bisection finds: the wheel alone, else the throttle alone, else
    both. If none of these verifies, the backup controller's input is executed.

    Parameters
    ----------
    present : a search with the present in future 0. tail : the stored sequence. known : whether there is a proposal.
    proposal : acceleration [m/s^2] and front wheel angle [rad], (2,). inputs : the executed input, (2,), written.

    Returns
    -------
    The tier (see `shield.batch.codes`), and the least clearance beyond the buffer [m], NaN if it was not computed.
    """
    margin = _after(search, present, tail, proposal[0], proposal[1]) if known else -np.inf
    if margin >= 0:
        _store(search, tail, search.bounds.depth)
        _take(present, inputs, proposal[0], proposal[1])
        return _PASSED, margin
    tier = _STORED
    if tail.counts[0] + tail.counts[1] == 0:
        tier, margin = _anew(search, present, tail)
        if tier == _LARGEST:
            advance_backup(present, tail, inputs)
            # Without a sequence that keeps the buffer, the search is repeated in the next frame.
            tail.counts[0], tail.counts[1] = 0, 0
            return tier, margin
    if known:
        _peek(search, present, tail, inputs)
        for kept in (_THROTTLE, _WHEEL, _NEITHER):
            share, found = _nearest(search, present, tail, proposal, inputs, kept)
            if share >= 0:
                _take(present, inputs, *_between(proposal, inputs, kept, share))
                return _GOVERNED, found
    if tail.counts[1] == 0 and tier == _STORED:
        # The stored sequence is replaced before its end if it can be extended.
        set_root(search, present.futures, 0)
        if _goes_on(search, tail) >= 0:
            _store(search, tail, search.bounds.depth)
    advance_backup(present, tail, inputs)
    return tier, margin if tier == _ALTERNATIVE else math.nan
