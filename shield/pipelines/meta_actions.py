"""The pipeline for meta-actions: proposal, rules, verification, repair, fallback.

The invariant holds if a scene admits a verified plan and the others keep to the assumptions. Then no executed action
brings the ego nearer to another vehicle than the buffer. It follows by induction. An action is executed for one frame
only if the fail-safe after it stays clear of every place that the others can reach. The fail-safe brakes to a stop in a
lane. If no plan verifies, the fail-safe verified at the previous frame is continued.

The frames between two decisions are supervised by `shield.pipelines.frames`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import takewhile
from typing import Any

import numpy as np

from dynamics.scenes.scene import Scene, Target
from dynamics.state import FloatArray
from shield.alternatives.preference import default_order, resolve
from shield.certificate.road.manoeuvres import brake_candidates
from shield.certificate.road.memory import Memory, ObservedScene, observe
from shield.certificate.road.verify import ROUNDING
from shield.config import ShieldConfig
from shield.decision import Reason, Tier
from shield.pipelines.decide import JudgedPlan, Plan, Unreadable
from shield.pipelines.frames import AccelerationCap, capped_speeds, fail_lanes, first_verified
from shield.pipelines.screen import MetaActionProposal, RuleScreen, slower

__all__ = ["MetaActionPipeline"]


class MetaActionPipeline:
    """Decides about meta-actions.

    Parameters
    ----------
    config : settings.

    Attributes
    ----------
    screen : the rules that run before the verification.
    """

    def __init__(self, config: ShieldConfig) -> None:
        self.config = config
        self.screen, self._hold_back = RuleScreen(config), AccelerationCap(begins=True)

    def refuses(self, scene: Scene, proposal: MetaActionProposal) -> Reason | None:
        """Reason if the proposal is invalid or the scene is not finite; else None."""
        return self.screen.refuses(scene, proposal)

    def observe(self, memory: Memory[int], scene: Scene) -> tuple[ObservedScene, Memory[int]]:
        """Observe a scene: monitor, and reachable places of the others."""
        now = observe(memory, scene, self.config)
        return now, now.memory

    def plans(self, now: ObservedScene, proposal: MetaActionProposal) -> Iterator[JudgedPlan[int]]:
        """The proposal; the proposal with another speed; alternatives; the proposal with an acceleration cap; then all
        other actions."""
        scene, action = now.scene, proposal.action
        target = scene.target_of(action)
        changes = _changes_lane(now, target)
        if self.screen.buffer.objects(scene, target):
            reason = Reason.BUFFER
        else:
            # The frames can cap the acceleration of a longitudinal proposal; a lane change is expected to be completed.
            (plan,) = self._verify(now, [action], [target], forecast=changes)
            yield JudgedPlan(Tier.PASSED, Reason.NONE, plan)
            reason = self.screen.why(scene, target)
        labels = scene.control.actions
        targets = [scene.target_of(a) for a in range(len(labels))]
        alternatives = self._alternatives(now, proposal, targets, changes)
        if changes:
            # A lane change that may verify with another speed.
            for plan in self._verify_actions(now, [action], targets):
                yield JudgedPlan(Tier.GOVERNED, reason, plan)
        for plan in self._verify_actions(now, alternatives, targets):
            yield JudgedPlan(Tier.ALTERNATIVE, reason, plan)
        # Without a policy order, an acceleration cap is preferred to another action.
        kept = ([] if changes else [action]) + [labels.index(x) for x in ("IDLE", "SLOWER") if x in labels]
        for a in kept:
            for capped in self._hold_back.plans(now, targets[a]):
                yield JudgedPlan(Tier.GOVERNED, reason, replace(capped, action=a, path=_from_here(now, capped.path)))
        # The remaining actions, without the forecast for the whole decision: the certificate needs one frame only.
        rest = [a for a in range(len(labels)) if a != action]
        for plan in self._verify_actions(now, rest, targets, forecast=False):
            yield JudgedPlan(Tier.ALTERNATIVE, reason, plan)

    def fall_back(
        self, now: ObservedScene, proposal: MetaActionProposal, tried: list[JudgedPlan[int]]
    ) -> JudgedPlan[int]:
        """SLOWER; the frames continue the stored plan."""
        tier, plan = self.last_resort(now.memory, now.scene, proposal)
        stored_verifies = (
            tier is Tier.STORED_PLAN and not now.memory.watch.violated and now.fail_safe().margin >= -ROUNDING
        )
        return JudgedPlan(tier, Reason.PRECAUTION if stored_verifies else Reason.NO_SAFE_PLAN, plan)

    def last_resort(
        self, memory: Memory[int], scene: Scene | Unreadable, proposal: MetaActionProposal
    ) -> tuple[Tier, Plan[int]]:
        """SLOWER; the frames continue the stored plan."""
        tier = Tier.STORED_PLAN if memory.stored is not None else Tier.EMERGENCY
        return tier, Plan(slower(proposal.labels), stored=memory.stored, entered=memory.entered)

    def mask(self, memory: Memory[int], scene: Scene) -> Any:
        """Mask of the actions that verify unchanged, (actions,) bool; all False only if none does."""
        labels = scene.control.actions
        mask = np.zeros(len(labels), dtype=bool)
        if not scene.finite:
            return mask
        now = observe(memory, scene, self.config)
        targets = [scene.target_of(a) for a in range(len(labels))]
        for forecast in (False, True):
            group = [
                a
                for a, target in enumerate(targets)
                if _changes_lane(now, target) is forecast and not self.screen.buffer.objects(scene, target)
            ]
            if group:
                plans = self._verify(now, group, [targets[a] for a in group], forecast)
                mask[group] = [plan.verified for plan in plans]
        return mask

    def lasts(self, now: ObservedScene, action: int) -> bool:
        """Whether an action must be expected to last for the whole decision, besides verifying for a frame."""
        return _changes_lane(now, now.scene.target_of(action))

    # -- pieces ------------------------------------------------------------------------------------------

    def _alternatives(
        self, now: ObservedScene, proposal: MetaActionProposal, targets: list[Target], changes: bool
    ) -> list[int]:
        """Actions that may replace the proposal, in the policy's order or the default one."""
        labels, wanted = now.scene.control.actions, resolve(proposal.order)
        if wanted is None:
            # An acceleration cap of these actions is tried first, before a deliberate deceleration.
            stop = ("SLOWER",) if changes else ("FASTER", "IDLE", "SLOWER")
            ordered = default_order(now.scene, proposal.action, targets)
            wanted = list(takewhile(lambda a: labels[a] not in stop, ordered))
        # An action with the same target command is the same action under another name.
        return [a for a in wanted if a != proposal.action and targets[a] != targets[proposal.action]]

    def _verify(
        self, now: ObservedScene, actions: Sequence[int], targets: list[Target], forecast: bool = False
    ) -> list[Plan[int]]:
        """Verify each target command for one frame: the bound of the certificate.

        With `forecast`, a plan gets the lower margin of that bound and of a forecast for the decision period, with the
        others at constant speed. An alternative is expected to last for the whole period.
        """
        scene = now.scene
        pairs = [(i, f) for i, t in enumerate(targets) for f in fail_lanes(now, t.lane)]
        lanes, speeds = [targets[i].lane for i, _ in pairs], [targets[i].speed for i, _ in pairs]
        fails = [f for _, f in pairs]
        period, braking = scene.frames_per_decision, self.config.braking
        paths, bound = now.judge(brake_candidates(scene, lanes, speeds, fails, 1, braking))
        margins, results = bound.margin, [bound] * len(pairs)
        if forecast:
            lasting = brake_candidates(scene, lanes, speeds, fails, period, braking)
            paths, expected = now.judge(lasting, period)
            sooner = expected.margin < margins
            margins = np.minimum(margins, expected.margin)
            results = [expected if earlier else bound for earlier in sooner]
        owner = np.array([i for i, _ in pairs])
        out = []
        for i, action in enumerate(actions):
            rows = np.flatnonzero(owner == i)
            best = int(rows[first_verified(margins[rows])])
            path, occupancy = paths[best], None
            if self.config.record:
                hold = period if forecast else 0
                occupancy = now.verifier.around.occupancy(len(path), hold).rectangles()
            path, binding = _from_here(now, path), results[best].binding(best)
            out.append(Plan(action, float(margins[best]), fails[best], path, binding, occupancy=occupancy))
        return out

    def _verify_actions(
        self, now: ObservedScene, actions: Sequence[int], targets: list[Target], forecast: bool = True
    ) -> list[Plan[int]]:
        """Verify alternatives in one batch; a lane change also with capped speeds."""
        labels = now.scene.control.actions
        owner: list[int] = []
        tried: list[Target] = []
        for a in actions:
            if self.screen.buffer.objects(now.scene, targets[a]):
                continue
            speeds = {targets[a].speed}
            if labels[a].startswith("LANE"):
                speeds |= capped_speeds(now, targets[a])
            owner += [a] * len(speeds)
            tried += [Target(targets[a].lane, speed) for speed in sorted(speeds)]
        if not tried:
            return []
        best: dict[int, Plan[int]] = {}
        for plan in self._verify(now, owner, tried, forecast):
            if plan.action not in best or plan.margin > best[plan.action].margin:
                best[plan.action] = plan
        return [best[a] for a in actions if a in best]


def _from_here(now: ObservedScene, path: FloatArray | None) -> FloatArray:
    """Path with the ego's present state in front, (frames + 1, 4)."""
    return np.vstack([now.scene.ego_road, np.empty((0, 4)) if path is None else path])


def _changes_lane(now: ObservedScene, target: Target) -> bool:
    """Whether a target command is in another lane than the ego."""
    return target.lane != now.here
