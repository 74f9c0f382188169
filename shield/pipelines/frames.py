"""The pipeline between two decisions: the target command frame by frame, with an acceleration cap if it does not
verify.

A proposal is the target command of the environment's controllers. The executed command is the same, or a
`FrameCommand`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dynamics.scenes.scene import Scene, Target
from dynamics.state import BoolArray, FloatArray, IntArray, State
from dynamics.vehicle.controllers import KP_SPEED
from shield.certificate.road.manoeuvres import Brakes, brake_candidates
from shield.certificate.road.memory import Memory, ObservedScene, observe
from shield.certificate.road.verify import ROUNDING, Clearance, least_bad, least_bad_evasion
from shield.config import ShieldConfig
from shield.decision import Reason, Tier
from shield.pipelines.decide import JudgedPlan, Plan, Unreadable

__all__ = [
    "ACCELERATIONS",
    "CAPS",
    "GREATEST",
    "LANE_PENALTY",
    "AccelerationCap",
    "FrameCommand",
    "FramePipeline",
    "Repair",
    "capped_speeds",
    "fail_lanes",
    "first_verified",
]


ACCELERATIONS = 32
"""Grid points between full braking and the target command's acceleration, for the acceleration cap."""
LANE_PENALTY = 2.0
"""Cost of leaving the target lane, in acceleration [m/s^2]."""
GREATEST = 5.0
"""Greatest acceleration of a cap [m/s^2]."""
CAPS = (-4.0, -2.0, 0.0, 5.0)
"""Changes of speed to which the speed of a lane change may be capped, rounded down to the grid [m/s]."""
_BOUND_SHARES = (0.75, 0.5, 0.25, 0.0)
"""Widths of the others' bounds that are tried if no candidate is clear of the full bounds, as shares."""


@dataclass(frozen=True, slots=True)
class FrameCommand:
    """Command for one frame: the lane to steer to and an acceleration [m/s^2]. A front wheel angle [rad] replaces the
    lane controller's steering."""

    lane: int
    acceleration: float
    steering: float | None = None


class Repair(Protocol):
    """Replacement of a target command that does not verify at this frame."""

    def plans(self, now: ObservedScene, target: Target) -> Iterator[Plan[int]]:
        """Plans in order."""


class AccelerationCap:
    """Acceleration cap for one frame: the greatest acceleration that verifies, the target lane first.

    Parameters
    ----------
    begins : whether a decision uses it, of which only the action is executed. Then it is restricted to the plans that
        the next frame will try, after their stop lane has replaced the stored one.
    """

    def __init__(self, begins: bool = False) -> None:
        self._begins = begins

    def plans(self, now: ObservedScene, target: Target) -> Iterator[Plan[int]]:
        """One plan; the least bad if none verifies."""
        scene, lanes = now.scene, fail_lanes(now, target.lane)
        v, grid = float(scene.ego[State.SPEED]), _accelerations(now, target)
        # Each target lane is combined with each lane of the fail-safe.
        steer = np.repeat(lanes, grid.size)
        fails = np.repeat(lanes, steer.size)
        steer = np.resize(steer, fails.size)
        accelerations = np.resize(grid, fails.size)
        if self._begins:
            tried = (steer == target.lane) | (steer == now.here) | (steer == fails)
            steer, fails, accelerations = steer[tried], fails[tried], accelerations[tried]
        speeds = v + accelerations / KP_SPEED
        candidates = brake_candidates(scene, steer, speeds, fails, 1, now.config.braking)
        paths, result = now.judge(candidates)
        cost = np.where(candidates.lanes == target.lane, 0.0, LANE_PENALTY)
        score = np.where(result.margin >= 0, accelerations - cost, -np.inf)
        i = int(score.argmax())
        if not np.isfinite(score[i]):
            i = least_bad(result)
        yield _plan(candidates, accelerations, paths, result, i)


class FramePipeline:
    """Supervises the frames between two decisions about meta-actions.

    Parameters
    ----------
    config : settings.
    repair : replacement of a target command that does not verify; `AccelerationCap` by default.
    """

    def __init__(self, config: ShieldConfig, repair: Repair | None = None) -> None:
        self.config, self._repair = config, repair if repair is not None else AccelerationCap()

    def refuses(self, scene: Scene, proposal: Target) -> Reason | None:
        """Reason if the scene is not finite; else None."""
        return None if scene.finite else Reason.BAD_SCENE

    def observe(self, memory: Memory[int], scene: Scene) -> tuple[ObservedScene, Memory[int]]:
        """Observe a scene: monitor, and reachable places of the others."""
        now = observe(memory, scene, self.config)
        return now, now.memory

    def plans(self, now: ObservedScene, proposal: Target) -> Iterator[JudgedPlan[int]]:
        """The target command for one more frame, and then its replacements."""
        fails = fail_lanes(now, proposal.lane)
        lanes, speeds = [proposal.lane] * len(fails), [proposal.speed] * len(fails)
        paths, result = now.judge(brake_candidates(now.scene, lanes, speeds, fails, 1, self.config.braking))
        i = first_verified(result.margin)
        plan = Plan(proposal, float(result.margin[i]), fails[i], paths[i], result.binding(i))
        yield JudgedPlan(Tier.PASSED, Reason.NONE, plan)
        for each in self._repair.plans(now, proposal):
            yield JudgedPlan(Tier.GOVERNED, Reason.UNVERIFIED, each)

    def fall_back(self, now: ObservedScene, proposal: Target, tried: list[JudgedPlan[int]]) -> JudgedPlan[int]:
        """Without a violation, the stored plan, also if it is not clear any more.

        After a violation, if the stored plan is clear of the compliant vehicles: the plan that stays clear of the
        violators longest among those that are, or else the stored plan. Otherwise the least bad plan, see `_evade`.
        """
        violated, reason = now.memory.watch.violated, Reason.NO_SAFE_PLAN
        kept = None if now.memory.stored is None else now.fail_safe(lawful=True)
        if kept is not None and (kept.margin >= -ROUNDING or not violated):
            if violated:
                plan, lawful = _evade(now, proposal)
                if lawful >= 0:
                    return JudgedPlan(Tier.EVADED, reason, plan)
            elif kept.margin >= -ROUNDING:
                reason = Reason.PRECAUTION
            command = FrameCommand(kept.lane, -self.config.braking)
            entered = now.memory.entered
            stored = Plan(command, kept.margin, kept.lane, kept.path, kept.binding, entered=entered)
            return JudgedPlan(Tier.STORED_PLAN, reason, stored)
        if now.scene.likely is not None:
            # With noise no candidate is clear of the bounds, but one may still be clear of the vehicles.
            return JudgedPlan(Tier.LARGEST_MARGIN, reason, _least_bad_of_shrunk_bounds(now, proposal))
        return JudgedPlan(Tier.LARGEST_MARGIN, reason, _evade(now, proposal)[0])

    def last_resort(self, memory: Memory[int], scene: Scene | Unreadable, proposal: Target) -> tuple[Tier, Plan[int]]:
        """Brake in the stored lane, or in the target lane without one."""
        lane = proposal.lane if memory.stored is None else memory.stored
        command = FrameCommand(lane, -self.config.braking)
        return Tier.EMERGENCY, Plan(command, stored=memory.stored, entered=memory.entered)


def _evade(now: ObservedScene, target: Target) -> tuple[Plan[int], float]:
    """The candidate that stays clear longest among those that are clear of the compliant vehicles, and its margin from
    these [m]. The margin is negative if there is no such candidate.

    In the worst case, no candidate may be clear of a violator. So the first criterion is the expected time, with every
    vehicle at constant velocity. The second is the time in the worst case. A vehicle that brakes ahead is not expected
    to brake further; the worst case covers that.
    """
    candidates, accelerations = _evasions(now, target)
    paths, result = now.judge(candidates)
    lawful, expected = result.margin, result
    if now.memory.watch.violated:
        lawful = now.lawful.clearance(paths, candidates.lanes, candidates.fails).margin
        expected = now.verifier.clearance(paths, candidates.lanes, candidates.fails, hold=paths.shape[1])
    keeps = lawful >= 0
    some = np.flatnonzero(keeps if keeps.any() else ~keeps)
    i = int(some[least_bad_evasion(_rows(expected, some), _rows(result, some))])
    return _plan(candidates, accelerations, paths, result, i), float(lawful[i])


def _least_bad_of_shrunk_bounds(now: ObservedScene, target: Target) -> Plan[int]:
    """The candidate that stays clear longest, among those that are clear of the widest bounds of which any candidate is
    clear. Candidates in the ego's own lane take precedence over the others."""
    candidates, accelerations = _evasions(now, target)
    paths, result = now.judge(candidates)
    own = candidates.lanes == now.here
    narrow: list[Clearance] = []

    def clear() -> Iterator[BoolArray]:
        for share in _BOUND_SHARES:
            narrow.append(now.with_shrunk_bounds(share).clearance(paths, candidates.lanes, candidates.fails))
            yield own & (narrow[-1].margin >= 0)
        for each in narrow:
            yield ~own & (each.margin >= 0)

    chosen = next((some for some in clear() if some.any()), None)
    i = least_bad(narrow[-1]) if chosen is None else _least_bad_of(result, chosen)
    return _plan(candidates, accelerations, paths, result, i)


def _least_bad_of(result: Clearance, some: BoolArray) -> int:
    """`least_bad` of some candidates, selected by `some` (n,)."""
    which = np.flatnonzero(some)
    return int(which[least_bad(_rows(result, which))])


def _rows(result: Clearance, which: IntArray) -> Clearance:
    """The clearances of some candidates, by index."""
    return Clearance(result.margin[which], result.clear[which])


def _plan(candidates: Brakes, accelerations: FloatArray, paths: FloatArray, result: Clearance, i: int) -> Plan[int]:
    """The plan of candidate i."""
    command = FrameCommand(int(candidates.lanes[i]), float(accelerations[i]))
    return Plan(command, float(result.margin[i]), int(candidates.fails[i]), paths[i], result.binding(i))


def _evasions(now: ObservedScene, target: Target) -> tuple[Brakes, FloatArray]:
    """Candidates with each acceleration, in the ego's lane and its neighbours; each stops in the lane that it steers
    to."""
    scene, here, grid = now.scene, now.here, _accelerations(now, target)
    lanes = [lane for lane in (here, here - 1, here + 1) if 0 <= lane < scene.road.centers.size]
    if now.memory.stored is not None and now.memory.stored not in lanes:
        lanes.append(now.memory.stored)
    steer, accelerations = np.repeat(lanes, grid.size), np.tile(grid, len(lanes))
    speeds = float(scene.ego[State.SPEED]) + accelerations / KP_SPEED
    return brake_candidates(scene, steer, speeds, steer, 1, now.config.braking), accelerations


def _accelerations(now: ObservedScene, target: Target) -> FloatArray:
    """Grid from full braking to the acceleration of the target command, (n,) [m/s^2]."""
    tracking, braking = KP_SPEED * (target.speed - float(now.scene.ego[State.SPEED])), now.config.braking
    return np.linspace(-braking, max(min(tracking, GREATEST), -braking), ACCELERATIONS)


def capped_speeds(now: ObservedScene, target: Target) -> set[float]:
    """Speeds to which `AccelerationCap` may cap a target command, one for each of `CAPS` [m/s]. A plan that verifies
    with one of them verifies at the first frame too."""
    grid = _accelerations(now, target)
    places = np.searchsorted(grid, KP_SPEED * np.array(CAPS), side="right") - 1
    return {float(now.scene.ego[State.SPEED]) + a / KP_SPEED for a in grid[np.maximum(places, 0)].tolist()}


def fail_lanes(now: ObservedScene, lane: int) -> list[int]:
    """Lanes in which the fail-safe may stop: the target lane, the ego's own, and the stored one."""
    here, stored = now.here, now.memory.stored
    if stored is None or abs(stored - here) > 1:
        stored = here
    return list(dict.fromkeys((lane, here, stored)))


def first_verified(margins: FloatArray) -> int:
    """Index of the first margin that verifies, in order of preference; of the largest margin if none does."""
    for i, margin in enumerate(margins.tolist()):
        if margin >= 0:
            return i
    return int(margins.argmax())
