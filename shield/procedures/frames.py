"""Between two decisions: the committed target, frame by frame, held back where it does not verify."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from dynamics.scenes.scene import Scene, Target
from dynamics.state import FloatArray, RoadState, State
from dynamics.vehicle.controllers import KP_SPEED
from shield.certificate.manoeuvres import Candidates, brake_candidates
from shield.certificate.memory import Memory
from shield.certificate.verify import NOTHING, ROUNDING, Binding, Clearance, least_bad
from shield.decision import Decision, Reason, Tier

__all__ = ["FrameCommand", "FrameSupervisor", "Verdict", "first_verified"]

_ACCELERATIONS = 32
"""Grid points between full braking and the committed acceleration, when a frame is held back."""
_LANE_PENALTY = 2.0
"""What it costs to leave the committed lane, in acceleration [m/s^2]."""


@dataclass(frozen=True, slots=True)
class FrameCommand:
    """What the actuators get for one frame: the lane to steer to and an acceleration [m/s^2]; None lets the
    environment's own controller act. A front wheel angle [rad], where given, takes the place of the steering."""

    lane: int
    acceleration: float
    steering: float | None = None


@dataclass(frozen=True, slots=True)
class Verdict:
    """Best margin of one action [m], the fail-safe lane and path that achieve it, and what it comes from."""

    margin: float
    fail_lane: int
    path: FloatArray | None
    binding: Binding = NOTHING


_UNKNOWN = Verdict(float("nan"), -1, None)


class FrameSupervisor(Memory):
    """Supervises the frames between two decisions about meta-actions.

    Parameters
    ----------
    config : settings; `ShieldConfig()` by default.
    """

    def supervise(self, scene: Scene, *, fresh: bool = False) -> tuple[FrameCommand | None, Decision]:
        """Check the committed target for one more frame, and hold it back if it has become unsafe.

        Parameters
        ----------
        scene : the scene at this frame; `scene.control.target` is what is committed to.
        fresh : whether `decide` has seen this very scene already.

        Returns
        -------
        The command for the actuators, or None to let the environment's controller act; and the record.
        """
        start = perf_counter()
        proposed = scene.control.target
        if not scene.finite:
            lane = self.stored_lane if self.stored_lane is not None else proposed.lane
            command = FrameCommand(lane, -self.config.braking)
            return command, _frame(proposed, command, Reason.BAD_SCENE, Tier.EMERGENCY, _UNKNOWN, start)
        if not fresh:
            self._observe(scene)
        fails = self._fail_lanes(scene, proposed.lane)
        lanes, speeds = [proposed.lane] * len(fails), [proposed.speed] * len(fails)
        candidates = brake_candidates(scene, lanes, speeds, fails, 1, self.config.braking)
        paths, result = self._judge(scene, candidates)
        best = first_verified(result.margin)
        margin = float(result.margin[best])
        if margin >= 0:
            self.stored_lane = fails[best]
            self.monitor.forgive()
            verdict = Verdict(margin, fails[best], paths[best], result.binding(best))
            return None, _frame(proposed, None, Reason.NONE, Tier.PASSED, verdict, start)
        command, verdict = self._mend(scene)
        if verdict.margin >= 0:
            self.stored_lane = verdict.fail_lane
            self.monitor.forgive()
            return command, _frame(proposed, command, Reason.UNVERIFIED, Tier.GOVERNED, verdict, start)
        command, verdict, tier = self._fall_back_frame(scene)
        return command, _frame(proposed, command, Reason.NO_SAFE_PLAN, tier, verdict, start)

    def _fall_back_frame(self, scene: Scene) -> tuple[FrameCommand, Verdict, Tier]:
        """Nothing verifies against everybody. The stored plan is kept as long as it clears those who have broken no
        rule; among what clears them, what clears the others longest is taken."""
        stored = None if self.stored_lane is None else self._fail_safe(scene, self._lawful(scene))
        if stored is not None and (stored.margin >= -ROUNDING or not self.monitor.violated):
            if self.monitor.violated:
                command, verdict, lawful = self._evade_frame(scene)
                if lawful >= 0:
                    self.stored_lane = verdict.fail_lane
                    return command, verdict, Tier.EVADED
            command = FrameCommand(stored.lane, -self.config.braking)
            return command, Verdict(stored.margin, stored.lane, stored.path, stored.binding), Tier.STORED_PLAN
        command, verdict, _ = self._evade_frame(scene)
        self.stored_lane = None
        return command, verdict, Tier.LARGEST_MARGIN

    def _evade_frame(self, scene: Scene) -> tuple[FrameCommand, Verdict, float]:
        """What clears everybody longest among what clears those who have broken no rule; and its margin from the latter
        [m], negative where nothing does."""
        candidates, accelerations = self._evasions(scene)
        paths, result = self._judge(scene, candidates)
        lawful = result.margin
        if self.monitor.violated:
            lawful = self._lawful(scene).clearance(paths, candidates).margin
        keeps = lawful >= 0
        every = np.flatnonzero(keeps) if keeps.any() else np.arange(len(paths))
        i = int(every[least_bad(Clearance(result.margin[every], result.clear[every]))])
        command = FrameCommand(int(candidates.lanes[i]), float(accelerations[i]))
        verdict = Verdict(float(result.margin[i]), int(candidates.fails[i]), paths[i], result.binding(i))
        return command, verdict, float(lawful[i])

    def _evasions(self, scene: Scene) -> tuple[Candidates, FloatArray]:
        """Accelerations in the ego's lane and its neighbours, each of which stops where it steers to."""
        v, braking = float(scene.ego[State.SPEED]), self.config.braking
        grid = self._accelerations(scene)
        here = scene.road.lane_at(float(scene.ego_road[RoadState.R]))
        lanes = [lane for lane in (here, here - 1, here + 1) if 0 <= lane < scene.road.centers.size]
        if self.stored_lane is not None and self.stored_lane not in lanes:
            lanes.append(self.stored_lane)
        steer, accelerations = np.repeat(lanes, grid.size), np.tile(grid, len(lanes))
        return brake_candidates(scene, steer, v + accelerations / KP_SPEED, steer, 1, braking), accelerations

    def _accelerations(self, scene: Scene) -> FloatArray:
        wish = KP_SPEED * (scene.control.target.speed - float(scene.ego[State.SPEED]))
        braking = self.config.braking
        return np.linspace(-braking, max(min(wish, 5.0), -braking), _ACCELERATIONS)

    def _mend(self, scene: Scene) -> tuple[FrameCommand, Verdict]:
        """What takes the place of a committed target that does not verify at this frame."""
        return self._hold_back(scene)

    def _hold_back(self, scene: Scene) -> tuple[FrameCommand, Verdict]:
        """The least intervention for one frame: the greatest acceleration that verifies, committed lane first."""
        target, v = scene.control.target, float(scene.ego[State.SPEED])
        grid, lanes = self._accelerations(scene), self._fail_lanes(scene, target.lane)
        # Each steering is tried with each fail-safe lane.
        steer = np.repeat(lanes, grid.size)
        fails = np.repeat(lanes, steer.size)
        steer = np.resize(steer, fails.size)
        accelerations = np.resize(grid, fails.size)
        candidates = brake_candidates(scene, steer, v + accelerations / KP_SPEED, fails, 1, self.config.braking)
        paths, result = self._judge(scene, candidates)
        cost = np.where(candidates.lanes == target.lane, 0.0, _LANE_PENALTY)
        score = np.where(result.margin >= 0, accelerations - cost, -np.inf)
        i = int(score.argmax())
        if not np.isfinite(score[i]):
            i = least_bad(result)
        command = FrameCommand(int(steer[i]), float(accelerations[i]))
        return command, Verdict(float(result.margin[i]), int(fails[i]), paths[i], result.binding(i))

    def brake_in_lane(self, lane: int, start: float) -> tuple[FrameCommand, Decision]:
        """The last resort of a frame, for when a stage has failed: brake in the stored lane, else in `lane`."""
        command = FrameCommand(lane if self.stored_lane is None else self.stored_lane, -self.config.braking)
        target = Target(lane, 0.0)
        return command, _frame(target, command, Reason.STAGE_FAILED, Tier.EMERGENCY, _UNKNOWN, start)

    # -- pieces ------------------------------------------------------------------------------------------

    def _fail_lanes(self, scene: Scene, lane: int) -> list[int]:
        """Lanes in which the fail-safe may stop: the committed one, the one that the ego is in, and the stored one."""
        here = scene.road.lane_at(float(scene.ego_road[RoadState.R]))
        stored = self.stored_lane
        if stored is None or abs(stored - here) > 1:
            stored = here
        return list(dict.fromkeys((lane, here, stored)))

    def _judge(self, scene: Scene, candidates: Candidates, hold: int = 0) -> tuple[FloatArray, Clearance]:
        paths = self._rollouts_for(scene).run(scene.ego_road, candidates.commands)
        return paths, self._survey(scene).clearance(paths, candidates, hold)


def first_verified(margins: FloatArray) -> int:
    """The first that verifies, in order of preference; the largest margin if none does."""
    good = np.flatnonzero(margins >= 0)
    return int(good[0]) if good.size else int(margins.argmax())


def _frame(
    proposed: Target, command: FrameCommand | None, reason: Reason, tier: Tier, verdict: Verdict, start: float
) -> Decision:
    executed: Any = proposed if command is None else command
    latency, (clause, vehicle) = perf_counter() - start, (verdict.binding.clause, verdict.binding.vehicle)
    margin, plan = verdict.margin, verdict.path
    return Decision(proposed, executed, reason, tier, margin, latency, plan, None, clause, vehicle)
