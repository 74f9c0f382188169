"""Decision about one frame of one of many environments, as by `shield.pipelines.frames.FramePipeline`."""

from __future__ import annotations

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.layout import TARGET, TARGET_SPEED
from dynamics.pass_by_pointer import Pointer, address_of, dereference
from shield.batch.arrays import (
    BatchMemory,
    BatchPointers,
    BatchRecords,
    BatchWorkspace,
    scene_of,
    without_precautions,
)
from shield.batch.codes import REASONS, TIERS
from shield.batch.observing import observe, set_stop_candidate
from shield.batch.parameters import NO_INDEX
from shield.batch.repairing import evade, fail_lanes, hold_back
from shield.batch.verifying import frames_of, verify
from shield.certificate.road.clauses.all_clauses import NOTHING_BINDS
from shield.certificate.road.clauses.workspace import ClauseScene
from shield.certificate.road.verify import ROUNDING
from shield.decision import Reason, Tier

__all__ = ["clear_violators", "stored_margin", "supervise", "violated"]

_PASSED, _GOVERNED, _STORED = TIERS.index(Tier.PASSED), TIERS.index(Tier.GOVERNED), TIERS.index(Tier.STORED_PLAN)
_EVADED, _LARGEST, _EMERGENCY = (
    TIERS.index(Tier.EVADED),
    TIERS.index(Tier.LARGEST_MARGIN),
    TIERS.index(Tier.EMERGENCY),
)
_NONE, _UNVERIFIED = REASONS.index(Reason.NONE), REASONS.index(Reason.UNVERIFIED)
_NO_PLAN, _BAD_SCENE = REASONS.index(Reason.NO_SAFE_PLAN), REASONS.index(Reason.BAD_SCENE)
_PRECAUTION = REASONS.index(Reason.PRECAUTION)


@kernel_inline
def violated(shields: BatchMemory, e: int) -> bool:
    """Whether a violator may still be in the way."""
    some = False
    for i in range(shields.offenders.shape[1]):
        some = some or shields.offenders[e, i]
    return some


@kernel_inline
def clear_violators(shields: BatchMemory, e: int) -> None:
    """Clear the violators, when a plan clears every vehicle again."""
    for i in range(shields.offenders.shape[1]):
        shields.offenders[e, i] = False


@kernel_inline
def _keep(records: BatchRecords, e: int, k: int, tier: int, reason: int, lane: int, acceleration: float) -> None:
    records.tiers[e, k], records.reasons[e, k] = tier, reason
    records.lanes[e, k], records.accelerations[e, k] = lane, acceleration
    records.margins[e, k], records.clauses[e, k], records.vehicles[e, k] = float("nan"), NOTHING_BINDS, NO_INDEX


@kernel_inline
def _note(records: BatchRecords, e: int, k: int, workspace: BatchWorkspace, i: int) -> None:
    plans = workspace.plans
    records.margins[e, k], records.clauses[e, k], records.vehicles[e, k] = (
        plans.margins[i],
        plans.clauses[i],
        plans.vehicles[i],
    )


@kernel_no_refcount
def stored_margin(pointers: BatchPointers, e: int) -> float:
    """Judge the stored plan from now on as candidate 0, without precautions and without violators. Return its margin
    [m]."""
    shields, parameters, workspace = (
        dereference(pointers.shields),
        dereference(pointers.parameters),
        dereference(pointers.workspace),
    )
    frames, x = set_stop_candidate(shields, parameters, e, shields.stored[e], workspace), parameters.numbers
    scene = address_of(without_precautions(scene_of(shields, parameters, e)))
    verify(pointers, scene, x.one, (x.one, frames), x.none, shields.offenders[e], x.none)
    return float(workspace.plans.margins[0])


@kernel_no_refcount
def _fall_back(pointers: BatchPointers, scene: Pointer[ClauseScene], e: int, k: int, speed: float) -> None:
    """Continue the stored plan while it clears the vehicles without a violation. With a violator, choose among the
    candidates that clear those vehicles the one that clears the violators longest."""
    shields, parameters, workspace, records = (
        dereference(pointers.shields),
        dereference(pointers.parameters),
        dereference(pointers.workspace),
        dereference(pointers.records),
    )
    offended, stored, plans, braking = (
        violated(shields, e),
        shields.stored[e],
        workspace.plans,
        parameters.numbers.braking,
    )
    if stored != NO_INDEX:
        stored_margin(pointers, e)
        margin, clause, vehicle = plans.margins[0], plans.clauses[0], plans.vehicles[0]
        if margin >= -ROUNDING or not offended:
            if offended:
                found = evade(pointers, scene, e, speed, offended)
                if plans.lawful[found] >= 0:
                    _keep(records, e, k, _EVADED, _NO_PLAN, plans.lanes[found], plans.accelerations[found])
                    _note(records, e, k, workspace, found)
                    shields.stored[e] = plans.fails[found]
                    return
            reason = _PRECAUTION if margin >= -ROUNDING and not offended else _NO_PLAN
            _keep(records, e, k, _STORED, reason, stored, -braking)
            records.margins[e, k], records.clauses[e, k], records.vehicles[e, k] = margin, clause, vehicle
            return
    found = evade(pointers, scene, e, speed, offended)
    _keep(records, e, k, _LARGEST, _NO_PLAN, plans.lanes[found], plans.accelerations[found])
    _note(records, e, k, workspace, found)
    shields.stored[e] = NO_INDEX


@kernel_no_refcount
def supervise(pointers: BatchPointers, e: int, k: int) -> None:
    """Decide about frame `k` of a decision, into `records`. If its tier is not `PASSED`, a lane and an acceleration
    replace those of the ego's controllers."""
    shields, parameters, worlds = (
        dereference(pointers.shields),
        dereference(pointers.parameters),
        dereference(pointers.worlds),
    )
    workspace, records = dereference(pointers.workspace), dereference(pointers.records)
    lane, speed, braking = worlds.g[e, TARGET, 0], worlds.f[e, TARGET_SPEED, 0], parameters.numbers.braking
    if not observe(pointers, e):
        stop = lane if shields.stored[e] == NO_INDEX else shields.stored[e]
        _keep(records, e, k, _EMERGENCY, _BAD_SCENE, stop, -braking)
        return
    plans, fails, v = workspace.plans, workspace.marks[2], shields.ego[e, 3]
    n, scene = fail_lanes(shields, parameters, e, lane, fails), address_of(scene_of(shields, parameters, e))
    for i in range(n):
        plans.lanes[i], plans.fails[i], plans.speeds[i] = lane, fails[i], speed
    x = parameters.numbers
    frames = frames_of(parameters, v, speed, x.one)
    found = verify(pointers, scene, n, (x.one, frames), x.none, workspace.nobody, x.one)
    if found != NO_INDEX:
        _keep(records, e, k, _PASSED, _NONE, lane, 0.0)
        _note(records, e, k, workspace, found)
        shields.stored[e] = plans.fails[found]
        clear_violators(shields, e)
        return
    found = hold_back(pointers, scene, e, lane, speed, parameters.numbers.none)
    if found != NO_INDEX:
        _keep(records, e, k, _GOVERNED, _UNVERIFIED, plans.lanes[found], plans.accelerations[found])
        _note(records, e, k, workspace, found)
        shields.stored[e] = plans.fails[found]
        clear_violators(shields, e)
        return
    _fall_back(pointers, scene, e, k, speed)
