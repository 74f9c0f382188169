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
from shield.certificate.verify import Clearance, least_bad
from shield.decision import Decision, Reason, Tier

__all__ = ["FrameCommand", "FrameSupervisor", "Verdict", "first_verified"]

_ACCELERATIONS = 12
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
    """Best margin of one action [m], and the fail-safe lane and path that achieve it."""

    margin: float
    fail_lane: int
    path: FloatArray


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
            return command, _frame(proposed, command, Reason.BAD_SCENE, Tier.EMERGENCY, np.nan, start)
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
            record = _frame(proposed, None, Reason.NONE, Tier.PASSED, margin, start, paths[best])
            return None, record
        command, verdict = self._mend(scene)
        if verdict.margin >= 0:
            self.stored_lane = verdict.fail_lane
            return command, _frame(
                proposed,
                command,
                Reason.UNVERIFIED,
                Tier.GOVERNED,
                verdict.margin,
                start,
                verdict.path,
            )
        if self.stored_lane is not None and not self.monitor.violated:
            command = FrameCommand(self.stored_lane, -self.config.braking)
            return command, _frame(proposed, command, Reason.NO_SAFE_PLAN, Tier.STORED_PLAN, margin, start)
        command, verdict = self._hold_back(scene, evade=True)
        self.stored_lane = None
        return command, _frame(
            proposed,
            command,
            Reason.NO_SAFE_PLAN,
            Tier.LARGEST_MARGIN,
            verdict.margin,
            start,
            verdict.path,
        )

    def _mend(self, scene: Scene) -> tuple[FrameCommand, Verdict]:
        """What takes the place of a committed target that does not verify at this frame."""
        return self._hold_back(scene)

    def _hold_back(self, scene: Scene, evade: bool = False) -> tuple[FrameCommand, Verdict]:
        """The least intervention for one frame: the greatest acceleration that verifies, committed lane first.

        With `evade`, every neighbouring lane is looked at and the largest margin wins instead.
        """
        target, v = scene.control.target, float(scene.ego[State.SPEED])
        braking = self.config.braking
        wish = KP_SPEED * (target.speed - v)
        grid = np.linspace(-braking, max(min(wish, 5.0), -braking), _ACCELERATIONS)
        lanes = self._fail_lanes(scene, target.lane)
        if evade:
            here = scene.road.lane_at(float(scene.ego_road[RoadState.R]))
            beside = (here - 1, here, here + 1)
            lanes = [lane for lane in beside if 0 <= lane < scene.road.centers.size]
        # An evading ego stops where it steers to; otherwise each steering is tried with each fail-safe lane.
        steer = np.repeat(lanes, grid.size)
        fails = steer if evade else np.repeat(lanes, steer.size)
        steer = np.resize(steer, fails.size)
        accelerations = np.resize(grid, fails.size)
        candidates = brake_candidates(scene, steer, v + accelerations / KP_SPEED, fails, 1, braking)
        paths, result = self._judge(scene, candidates)
        cost = np.where(candidates.lanes == target.lane, 0.0, _LANE_PENALTY)
        score = np.where(result.margin >= 0, accelerations - cost, -np.inf)
        i = int(score.argmax())
        if evade or not np.isfinite(score[i]):
            i = least_bad(result)
        command = FrameCommand(int(steer[i]), float(accelerations[i]))
        return command, Verdict(float(result.margin[i]), int(fails[i]), paths[i])

    def brake_in_lane(self, lane: int, start: float) -> tuple[FrameCommand, Decision]:
        """The last resort of a frame, for when a stage has failed: brake in the stored lane, else in `lane`."""
        command = FrameCommand(lane if self.stored_lane is None else self.stored_lane, -self.config.braking)
        target = Target(lane, 0.0)
        return command, _frame(target, command, Reason.STAGE_FAILED, Tier.EMERGENCY, np.nan, start)

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
    proposed: Target,
    command: FrameCommand | None,
    reason: Reason,
    tier: Tier,
    margin: float,
    start: float,
    plan: FloatArray | None = None,
) -> Decision:
    executed: Any = proposed if command is None else command
    return Decision(proposed, executed, reason, tier, margin, perf_counter() - start, plan)
