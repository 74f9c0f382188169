"""The decision procedure: propose, rules, verify, repair, fall back.

The invariant: if a scene admits a verified plan and the others keep to the assumptions, nothing that the core
lets through or substitutes ever brings the ego nearer to another vehicle than the buffer. It holds by
induction: an action is executed for one frame only if, after it, the fail-safe manoeuvre (brake to a stop in a
lane) stays clear of every place where the others can be; where nothing verifies, the fail-safe verified at the
frame before is played on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import takewhile
from time import perf_counter
from typing import Any

import numpy as np

from dynamics.scenes.scene import Scene, Target
from dynamics.state import RoadState, State
from shield.certificate.manoeuvres import brake_candidates
from shield.config import ShieldConfig
from shield.decision import Decision, Reason, Tier
from shield.procedures.frames import FrameSupervisor, Verdict, first_verified
from shield.procedures.screen import Screen, slower
from shield.repair.order import Order, default_order, resolve

__all__ = ["ShieldCore"]

_CAPS = (-4.0, -2.0, 0.0, 5.0)
"""Speed changes at which a lane change is tried when it does not verify as it is [m/s]."""


class ShieldCore(FrameSupervisor):
    """Decides about meta-actions; the frames between two decisions are its base's.

    Parameters
    ----------
    config : settings; `ShieldConfig()` by default.
    """

    def __init__(self, config: ShieldConfig | None = None) -> None:
        super().__init__(config)
        self._screen = Screen(self.config)

    # -- decisions ---------------------------------------------------------------------------------------

    def decide(self, scene: Scene, proposed: int, order: Order = None) -> Decision:
        """Choose the meta-action to commit to; frames are supervised afterwards by `supervise`.

        Parameters
        ----------
        scene : the scene now.
        proposed : the policy's action index.
        order : the alternatives in the policy's order of preference, or a function that gives it;
            `default_order` without one.
        """
        start = perf_counter()
        screened = self._screen.decide(scene, proposed, self.fallback, start)
        if screened is not None:
            return screened
        self._observe(scene)
        target = scene.target_of(proposed)
        reason = Reason.NONE
        if self._screen.buffer.objects(scene, target):
            reason = Reason.BUFFER
        else:
            # A longitudinal proposal can be held back by the frames; a lane change should be able to end well.
            verdict = self._verify(scene, [target], forecast=self._changes_lane(scene, target))[0]
            if verdict.margin >= 0:
                return self._made(scene, proposed, proposed, reason, Tier.PASSED, verdict, start)
            reason = self._screen.why(scene, target)
        return self._repair(scene, proposed, target, reason, order, start)

    def _repair(
        self,
        scene: Scene,
        proposed: int,
        target: Target,
        reason: Reason,
        order: Order,
        start: float,
    ) -> Decision:
        labels = scene.control.actions
        targets = [scene.target_of(a) for a in range(len(labels))]
        # An override that has no policy order behind it holds the proposal back rather than drop it.
        held = None if self._changes_lane(scene, target) else proposed
        wanted = resolve(order)
        if wanted is None:
            # What can be held back comes before what slows down on purpose.
            stop = ("SLOWER",) if held is None else ("FASTER", "IDLE", "SLOWER")
            ordered = default_order(scene, proposed, targets)
            alternatives = list(takewhile(lambda a: labels[a] not in stop, ordered))
        else:
            alternatives = [a for a in wanted if a != proposed]
        # An action that sets the same target would be the same action under another name.
        alternatives = [a for a in alternatives if targets[a] != target]
        if held is None:
            # A lane change that only its speed stands in the way of.
            for action, verdict in self._verify_actions(scene, [proposed], targets):
                if verdict.margin >= 0:
                    return self._made(scene, proposed, action, reason, Tier.GOVERNED, verdict, start)
        for action, verdict in self._verify_actions(scene, alternatives, targets):
            if verdict.margin >= 0:
                return self._made(scene, proposed, action, reason, Tier.ALTERNATIVE, verdict, start)
        kept = [held] if held is not None else []
        kept += [labels.index(x) for x in ("IDLE", "SLOWER") if x in labels]
        for action in kept:
            probe = replace(scene, control=replace(scene.control, target=targets[action]))
            _, verdict = self._hold_back(probe)
            if verdict.margin >= 0:
                return self._made(scene, proposed, action, reason, Tier.GOVERNED, verdict, start)
        # Whatever is left, whether or not it is expected to last: the certificate needs one frame only.
        rest = [a for a in range(len(labels)) if a != proposed]
        for action, verdict in self._verify_actions(scene, rest, targets, forecast=False):
            if verdict.margin >= 0:
                return self._made(scene, proposed, action, reason, Tier.ALTERNATIVE, verdict, start)
        return self.fallback(labels, proposed, Reason.NO_SAFE_PLAN, start)

    def action_mask(self, scene: Scene) -> Any:
        """Which actions verify as they are, (actions,) bool; all False only if none does."""
        labels = scene.control.actions
        targets = [scene.target_of(a) for a in range(len(labels))]
        mask = np.zeros(len(labels), dtype=bool)
        if not scene.finite:
            return mask
        self._observe(scene)
        for forecast in (False, True):
            group = [
                a
                for a, target in enumerate(targets)
                if self._changes_lane(scene, target) is forecast and not self._screen.buffer.objects(scene, target)
            ]
            if group:
                verdicts = self._verify(scene, [targets[a] for a in group], forecast)
                mask[group] = [v.margin >= 0 for v in verdicts]
        return mask

    # -- pieces ------------------------------------------------------------------------------------------

    @staticmethod
    def _changes_lane(scene: Scene, target: Target) -> bool:
        return target.lane != scene.road.lane_at(float(scene.ego_road[RoadState.R]))

    def _verify(self, scene: Scene, targets: list[Target], forecast: bool = False) -> list[Verdict]:
        """Margin of each target, committed to for one frame: the bound that the certificate rests on.

        With `forecast`, those that are expected to need holding back within the decision period (at constant speed
        of the others) are marked down too: an alternative should last for the whole period.
        """
        pairs = [(i, f) for i, t in enumerate(targets) for f in self._fail_lanes(scene, t.lane)]
        lanes, speeds = [targets[i].lane for i, _ in pairs], [targets[i].speed for i, _ in pairs]
        fails = [f for _, f in pairs]
        period, braking = scene.frames_per_decision, self.config.braking
        paths, bound = self._judge(scene, brake_candidates(scene, lanes, speeds, fails, 1, braking))
        margins, results = bound.margin, [bound] * len(pairs)
        if forecast:
            lasting = brake_candidates(scene, lanes, speeds, fails, period, braking)
            paths, expected = self._judge(scene, lasting, period)
            sooner = expected.margin < margins
            margins = np.minimum(margins, expected.margin)
            results = [expected if earlier else bound for earlier in sooner]
        owner = np.array([i for i, _ in pairs])
        out = []
        for i in range(len(targets)):
            rows = np.flatnonzero(owner == i)
            best = int(rows[first_verified(margins[rows])])
            out.append(Verdict(float(margins[best]), fails[best], paths[best], results[best].binding(best)))
        return out

    def _verify_actions(
        self,
        scene: Scene,
        actions: Sequence[int],
        targets: list[Target],
        forecast: bool = True,
    ) -> list[tuple[int, Verdict]]:
        """Verify alternatives in one batch; a lane change also with its speed held back by the frames."""
        labels, v = scene.control.actions, float(scene.ego[State.SPEED])
        owner: list[int] = []
        tried: list[Target] = []
        for a in actions:
            if self._screen.buffer.objects(scene, targets[a]):
                continue
            speeds = {targets[a].speed}
            if labels[a].startswith("LANE"):
                speeds |= {min(targets[a].speed, v + cap) for cap in _CAPS}
            owner += [a] * len(speeds)
            tried += [Target(targets[a].lane, speed) for speed in sorted(speeds)]
        if not tried:
            return []
        verdicts = self._verify(scene, tried, forecast)
        best: dict[int, Verdict] = {}
        for a, verdict in zip(owner, verdicts, strict=True):
            if a not in best or verdict.margin > best[a].margin:
                best[a] = verdict
        return [(a, best[a]) for a in actions if a in best]

    def _made(
        self,
        scene: Scene,
        proposed: int,
        executed: int,
        reason: Reason,
        tier: Tier,
        verdict: Verdict,
        start: float,
    ) -> Decision:
        self.stored_lane = verdict.fail_lane
        path = verdict.path if verdict.path is not None else np.empty((0, 4))
        plan = np.vstack([scene.ego_road, path])
        occupancy = None
        if self.config.record:
            around = self._survey(scene).around
            hold = scene.frames_per_decision if tier is Tier.ALTERNATIVE else 0
            occupancy = around.occupancy(len(path), scene.dt, hold).rectangles()
        return Decision(
            proposed,
            executed,
            reason,
            tier,
            verdict.margin,
            perf_counter() - start,
            plan,
            occupancy,
            verdict.binding.clause,
            verdict.binding.vehicle,
        )

    def fallback(self, labels: Sequence[str], proposed: Any, reason: Reason, start: float) -> Decision:
        """No action verifies: slow down, and leave it to the frames to play the stored plan on."""
        tier = Tier.STORED_PLAN if self.stored_lane is not None else Tier.EMERGENCY
        return Decision(proposed, slower(labels), reason, tier, np.nan, perf_counter() - start)
