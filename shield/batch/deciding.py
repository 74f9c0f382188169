"""One decision in one of many environments, as by `shield.pipelines.meta_actions.MetaActionPipeline`."""

from __future__ import annotations

import math

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.arrays import Worlds
from dynamics.highway_simulator.layout import SPEED, TARGET, TARGET_SPEED, X, Y
from dynamics.highway_simulator.scene import next_target_speed
from dynamics.pass_by_pointer import Pointer, address_of, dereference
from dynamics.roads.straight import nearest
from dynamics.state import FloatArray, IntArray
from shield.alternatives.preference import CLEAR, GAIN, IN_LANE, RELATIVE_SPEED_WEIGHT
from shield.batch.arrays import BatchMemory, BatchPointers, BatchRecords, BatchWorkspace, scene_of
from shield.batch.codes import REASONS, TIERS
from shield.batch.observing import observe
from shield.batch.parameters import NO_INDEX, BatchParameters
from shield.batch.repairing import fail_lanes, held_back, hold_back
from shield.batch.supervising import clear_violators, stored_margin, violated
from shield.batch.verifying import frames_of, verify
from shield.certificate.road.clauses.all_clauses import NOTHING_BINDS
from shield.certificate.road.clauses.workspace import ClauseScene
from shield.certificate.road.verify import ROUNDING
from shield.decision import Reason, Tier
from shield.pipelines.frames import CAPS
from shield.rule_kernels import RuleScene, alongside, time_is_short, violates_rss

__all__ = ["decide", "is_blocked_alongside", "target_of", "verifies"]

_LEFT, _RIGHT, _FASTER = 0, 2, 3
_PASSED, _GOVERNED, _ALTERNATIVE = TIERS.index(Tier.PASSED), TIERS.index(Tier.GOVERNED), TIERS.index(Tier.ALTERNATIVE)
_STORED, _EMERGENCY = TIERS.index(Tier.STORED_PLAN), TIERS.index(Tier.EMERGENCY)
_NONE, _BUFFER, _UNVERIFIED = (REASONS.index(x) for x in (Reason.NONE, Reason.BUFFER, Reason.UNVERIFIED))
_RSS, _TTC, _NO_PLAN = (REASONS.index(x) for x in (Reason.RSS, Reason.TTC, Reason.NO_SAFE_PLAN))
_PRECAUTION = REASONS.index(Reason.PRECAUTION)
_BAD_SCENE, _BAD_ACTION = REASONS.index(Reason.BAD_SCENE), REASONS.index(Reason.BAD_ACTION)


@kernel_inline
def target_of(worlds: Worlds, parameters: BatchParameters, e: int, action: int) -> tuple[int, float]:
    """Lane and speed that the ego's controllers track after an action; see `BatchScene.target_of`."""
    label, lane, speed = parameters.labels[action], worlds.g[e, TARGET, 0], worlds.f[e, TARGET_SPEED, 0]
    if label >= _FASTER:
        return lane, next_target_speed(parameters.target_speeds, worlds.f[e, SPEED, 0], label)
    if label in (_LEFT, _RIGHT):
        to = min(max(lane + label - 1, 0), parameters.centers.shape[0] - 1)
        s, r = worlds.f[e, X, 0], worlds.f[e, Y, 0]
        near = abs(r - parameters.centers[to]) <= 2 * parameters.numbers.width
        return (to if near and 0.0 <= s < parameters.numbers.length + 5.0 else lane), speed
    return lane, speed


@kernel_inline
def _rule_scene(shields: BatchMemory, parameters: BatchParameters, e: int) -> RuleScene:
    """The last observed scene of one environment, as the rules read it."""
    now = shields.now[e]
    rows, states = shields.rows[e, now], shields.states[e, now]
    return RuleScene(shields.ego[e], shields.state[e], rows, states, parameters.centers, parameters.numbers.width)


@kernel_inline
def is_blocked_alongside(shields: BatchMemory, parameters: BatchParameters, e: int, lane: int) -> bool:
    """Whether a vehicle alongside forbids that lane."""
    return alongside(_rule_scene(shields, parameters, e), lane, parameters.numbers.longitudinal)


@kernel_inline
def _why(shields: BatchMemory, parameters: BatchParameters, e: int, lane: int, speed: float) -> int:
    """Recorded reason for a target that did not verify."""
    scene, x = _rule_scene(shields, parameters, e), parameters.numbers
    braking = (x.braking, x.leader_braking, x.follower_braking)
    response, more = (x.response, x.reaction), x.follower_acceleration
    if violates_rss(scene, lane, speed, braking, response, more):
        return _RSS
    if time_is_short(scene, lane, speed, x.ttc):
        return _TTC
    return _UNVERIFIED


@kernel_inline
def _progress(shields: BatchMemory, parameters: BatchParameters, e: int, lane: int) -> float:
    """See `shield.alternatives.preference.lane_progress`."""
    states, state, gap, faster = shields.states[e, shields.now[e]], shields.state[e], math.inf, 0.0
    for i in range(states.shape[0]):
        ahead = states[i, 0] - state[0]
        beside = abs(states[i, 1] - parameters.centers[lane]) < IN_LANE * parameters.numbers.width
        if beside and states[i, 0] > state[0] and ahead < gap:
            gap, faster = ahead, states[i, 3] - state[3]
    return CLEAR if gap == math.inf else gap + RELATIVE_SPEED_WEIGHT * faster


@kernel_inline
def _default_order(
    shields: BatchMemory,
    parameters: BatchParameters,
    worlds: Worlds,
    e: int,
    proposed: int,
    workspace: BatchWorkspace,
    out: IntArray,
) -> int:
    """Fill in `shield.alternatives.preference.default_order`. Return the number of actions."""
    labels, numbers, targets = parameters.labels, parameters.numbers, workspace.marks[5]
    here = _progress(shields, parameters, e, nearest(parameters.centers, shields.state[e, 1]))
    gains, count = workspace.numbers[1], 0
    for better in (True, False):
        first = count
        for a in range(labels.shape[0]):
            if a == proposed or labels[a] not in (_LEFT, _RIGHT) or targets[a] == worlds.g[e, TARGET, 0]:
                continue
            gain = _progress(shields, parameters, e, targets[a]) - here
            if (gain > GAIN) != better:
                continue
            place = count
            while place > first and gains[place - 1] < gain:
                out[place], gains[place] = out[place - 1], gains[place - 1]
                place -= 1
            out[place], gains[place] = a, gain
            count += 1
        if better:
            for a in (numbers.faster, numbers.idle, numbers.slower):
                if a not in (NO_INDEX, proposed) and (a != numbers.slower or labels[a] == 4):
                    out[count] = a
                    count += 1
    return count


@kernel_no_refcount
def verifies(
    pointers: BatchPointers,
    scene: Pointer[ClauseScene],
    e: int,
    target: tuple[int, float],
    frames: int,
    lasting: int,
    found: FloatArray,
) -> bool:
    """Whether a target lane and speed verify, for the first lane to stop in for which they do. The margin, that lane,
    the clause and the vehicle are written to `found`, (4,).

    With `lasting` frames, a target is refused if it is expected to need an acceleration cap within the decision.
    """
    parameters, workspace, lane, speed = (
        dereference(pointers.parameters),
        dereference(pointers.workspace),
        target[0],
        target[1],
    )
    plans, fails, x = workspace.plans, workspace.marks[2], parameters.numbers
    n = fail_lanes(dereference(pointers.shields), parameters, e, lane, fails)
    for i in range(n):
        plans.lanes[0], plans.fails[0], plans.speeds[0] = lane, fails[i], speed
        if verify(pointers, scene, x.one, (x.one, frames), x.none, workspace.nobody, x.one) == NO_INDEX:
            continue
        found[0], found[1], found[2], found[3] = plans.margins[0], fails[i], plans.clauses[0], plans.vehicles[0]
        if lasting > 0:
            if verify(pointers, scene, x.one, (x.period, lasting), x.period, workspace.nobody, x.one) == NO_INDEX:
                continue
            if plans.margins[0] < found[0]:
                found[0], found[2], found[3] = plans.margins[0], plans.clauses[0], plans.vehicles[0]
        return True
    return False


@kernel_no_refcount
def _speeds(parameters: BatchParameters, v: float, label: int, speed: float, workspace: BatchWorkspace) -> int:
    """Speeds at which a target is tried, ascending, in `room.grid[1]`. For a lane change these include the capped
    speeds. Return their number."""
    out, n = workspace.grid[1], 1
    out[0] = speed
    if label in (_LEFT, _RIGHT):
        for cap in CAPS:
            one, place = held_back(parameters, v, speed, cap, workspace), 0
            while place < n and out[place] < one:
                place += 1
            if place < n and out[place] == one:
                continue
            for k in range(n, place, -1):
                out[k] = out[k - 1]
            out[place] = one
            n += 1
    return n


@kernel_no_refcount
def _first_action(
    pointers: BatchPointers,
    scene: Pointer[ClauseScene],
    e: int,
    actions: IntArray,
    count: int,
    forecast: int,
    found: FloatArray,
) -> int:
    """The first action that verifies, at the speed with the largest margin; otherwise -1. `found` as in `verifies`."""
    shields, parameters, workspace = (
        dereference(pointers.shields),
        dereference(pointers.parameters),
        dereference(pointers.workspace),
    )
    v, most, tried, wanted = shields.ego[e, 3], -math.inf, workspace.grid[1], workspace.numbers[0]
    for k in range(count):
        a = actions[k]
        if is_blocked_alongside(shields, parameters, e, workspace.marks[5, a]):
            continue
        n = _speeds(parameters, v, parameters.labels[a], wanted[a], workspace)
        most = max(most, tried[n - 1])
    if most == -math.inf:
        return NO_INDEX
    frames = frames_of(parameters, v, most, parameters.numbers.one)
    lasting = frames_of(parameters, v, most, parameters.numbers.period) if forecast > 0 else 0
    one = workspace.grid[2, :4]
    for k in range(count):
        a = actions[k]
        lane, best = workspace.marks[5, a], False
        if is_blocked_alongside(shields, parameters, e, lane):
            continue
        n = _speeds(parameters, v, parameters.labels[a], wanted[a], workspace)
        for i in range(n):
            works = verifies(pointers, scene, e, (lane, tried[i]), frames, lasting, one)
            if works and (not best or one[0] > found[0]):
                best = True
                for c in range(4):
                    found[c] = one[c]
        if best:
            return a
    return NO_INDEX


@kernel_inline
def _keep(
    shields: BatchMemory, records: BatchRecords, e: int, tier: int, reason: int, executed: int, found: FloatArray
) -> None:
    """Record and store a verified plan."""
    records.tier[e], records.reason[e], records.executed[e] = tier, reason, executed
    records.margin[e], records.clause[e], records.vehicle[e] = found[0], int(found[2]), int(found[3])
    shields.stored[e] = int(found[1])
    clear_violators(shields, e)


@kernel_inline
def _only_refused(pointers: BatchPointers, e: int) -> bool:
    """Whether only a precaution refuses all plans: the stored plan still verifies, and there is no violator."""
    shields = dereference(pointers.shields)
    if shields.stored[e] == NO_INDEX or violated(shields, e):
        return False
    return stored_margin(pointers, e) >= -ROUNDING


@kernel_inline
def _give_up(shields: BatchMemory, parameters: BatchParameters, records: BatchRecords, e: int, reason: int) -> None:
    """Slow down; the frames continue the stored plan."""
    records.tier[e] = _EMERGENCY if shields.stored[e] == NO_INDEX else _STORED
    records.reason[e], records.executed[e] = reason, parameters.numbers.slower
    records.margin[e], records.clause[e], records.vehicle[e] = math.nan, NOTHING_BINDS, NO_INDEX


@kernel_inline
def _alternatives(pointers: BatchPointers, e: int, proposed: int, order: IntArray, changes: bool, out: IntArray) -> int:
    """Fill in the alternatives to the proposal: in the policy's order, or in the documented one. Return their
    number."""
    shields, parameters, worlds = (
        dereference(pointers.shields),
        dereference(pointers.parameters),
        dereference(pointers.worlds),
    )
    workspace = dereference(pointers.workspace)
    lanes, wanted, ordered, n, kept = workspace.marks[5], workspace.numbers[0], workspace.marks[3], 0, 0
    if order.shape[0] > 0 and order[0] >= 0:
        while n < order.shape[0] and order[n] >= 0:
            ordered[n] = order[n]
            n += 1
    else:
        n = _default_order(shields, parameters, worlds, e, proposed, workspace, ordered)
        # An acceleration cap comes before an action that slows down.
        for k in range(n):
            label = parameters.labels[ordered[k]]
            if label == 4 or (not changes and label in (1, _FASTER)):
                n = k
                break
    for k in range(n):
        a = ordered[k]
        # An action with the same target is the same action under another name.
        if a != proposed and (lanes[a] != lanes[proposed] or wanted[a] != wanted[proposed]):
            out[kept] = a
            kept += 1
    return kept


@kernel_no_refcount
def _holds_back(
    pointers: BatchPointers,
    scene: Pointer[ClauseScene],
    e: int,
    proposed: int,
    changes: bool,
    reason: int,
    found: FloatArray,
) -> bool:
    """Whether the proposal, unless it is a lane change, or else IDLE or SLOWER verifies with an acceleration cap; it is
    recorded and stored."""
    shields, parameters, records = (
        dereference(pointers.shields),
        dereference(pointers.parameters),
        dereference(pointers.records),
    )
    workspace, numbers = dereference(pointers.workspace), parameters.numbers
    for executed in (
        NO_INDEX if changes else proposed,
        numbers.idle,
        numbers.slower if parameters.labels[numbers.slower] == 4 else -1,
    ):
        if executed == NO_INDEX:
            continue
        kept = hold_back(pointers, scene, e, workspace.marks[5, executed], workspace.numbers[0, executed], numbers.one)
        if kept != NO_INDEX:
            plans = workspace.plans
            found[0], found[1] = plans.margins[kept], plans.fails[kept]
            found[2], found[3] = plans.clauses[kept], plans.vehicles[kept]
            _keep(shields, records, e, _GOVERNED, reason, executed, found)
            return True
    return False


@kernel_inline
def _every_other_action(count: int, proposed: int, out: IntArray) -> int:
    """Fill in all actions but the proposal. Return their number."""
    n = 0
    for a in range(count):
        if a != proposed:
            out[n] = a
            n += 1
    return n


@kernel_no_refcount
def decide(pointers: BatchPointers, e: int, proposed: int, order: IntArray) -> None:
    """Decide about one meta-action, into `records`.

    Parameters
    ----------
    proposed : its index; any other number is an invalid action.
    order : the policy's order of preference among the other actions, up to the first negative entry; if empty, the
        documented order.
    """
    shields, parameters, worlds = (
        dereference(pointers.shields),
        dereference(pointers.parameters),
        dereference(pointers.worlds),
    )
    workspace, records = dereference(pointers.workspace), dereference(pointers.records)
    numbers, wanted, count = parameters.numbers, workspace.numbers[0], parameters.labels.shape[0]
    lanes, actions, found = workspace.marks[5], workspace.marks[4], workspace.grid[2, 4:8]
    records.proposed[e] = proposed
    if not 0 <= proposed < count:
        _give_up(shields, parameters, records, e, _BAD_ACTION)
        return
    if not observe(pointers, e):
        _give_up(shields, parameters, records, e, _BAD_SCENE)
        return
    scene = address_of(scene_of(shields, parameters, e))
    for a in range(count):
        lanes[a], wanted[a] = target_of(worlds, parameters, e, a)
    lane, speed, v = lanes[proposed], wanted[proposed], shields.ego[e, 3]
    changes, reason = lane != nearest(parameters.centers, shields.state[e, 1]), _BUFFER
    if not is_blocked_alongside(shields, parameters, e, lane):
        # The frames can cap the acceleration of a longitudinal proposal. A lane change should verify for the whole
        # decision.
        lasting = frames_of(parameters, v, speed, numbers.period) if changes else 0
        if verifies(pointers, scene, e, (lane, speed), frames_of(parameters, v, speed, numbers.one), lasting, found):
            _keep(shields, records, e, _PASSED, _NONE, proposed, found)
            return
        reason = _why(shields, parameters, e, lane, speed)
    if changes:
        # A lane change that verifies at a lower speed.
        actions[0] = proposed
        if _first_action(pointers, scene, e, actions, numbers.one, numbers.one, found) != NO_INDEX:
            _keep(shields, records, e, _GOVERNED, reason, proposed, found)
            return
    n = _alternatives(pointers, e, proposed, order, changes, actions)
    executed = _first_action(pointers, scene, e, actions, n, numbers.one, found)
    if executed != NO_INDEX:
        _keep(shields, records, e, _ALTERNATIVE, reason, executed, found)
        return
    # Without a policy order, an acceleration cap for the proposal comes before the remaining actions.
    if _holds_back(pointers, scene, e, proposed, changes, reason, found):
        return
    # The remaining actions, whether or not they are expected to verify to the end of the decision: the certificate
    # needs only one frame.
    n = _every_other_action(count, proposed, actions)
    executed = _first_action(pointers, scene, e, actions, n, numbers.none, found)
    if executed != NO_INDEX:
        _keep(shields, records, e, _ALTERNATIVE, reason, executed, found)
        return
    _give_up(shields, parameters, records, e, _PRECAUTION if _only_refused(pointers, e) else _NO_PLAN)
