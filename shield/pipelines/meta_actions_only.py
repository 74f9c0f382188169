"""The pipeline for meta-actions only: one call of `Shield.predict` per decision, without supervised frames.

The shield has no brake of its own, so the fail-safe is a sequence of meta-actions: any action, a lane change included,
and then SLOWER to the end. An ego with a slowest target speed above zero cannot stop. Then the certificate covers
`ShieldConfig.horizon` only.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from dynamics.scenes.scene import Scene
from dynamics.state import FloatArray
from dynamics.vehicle.rollouts import Rollouts
from shield.alternatives.preference import default_order, resolve
from shield.certificate.road.manoeuvres import meta_candidates
from shield.certificate.road.memory import Memory, ObservedScene, observe
from shield.certificate.road.verify import PathVerifier
from shield.config import ShieldConfig
from shield.decision import Reason, Tier
from shield.pipelines.decide import JudgedPlan, Plan, Unreadable
from shield.pipelines.screen import MetaActionProposal, RuleScreen, slower

__all__ = ["UnsupervisedMetaActionPipeline"]

Sequel = tuple[int, ...]
"""Remaining actions of a sequence."""


class UnsupervisedMetaActionPipeline:
    """Decides about meta-actions without supervised frames.

    Parameters
    ----------
    config : settings; `ShieldConfig.for_meta_actions()` by default.
    """

    def __init__(self, config: ShieldConfig | None = None) -> None:
        self.config = config if config is not None else ShieldConfig.for_meta_actions()
        self.screen = RuleScreen(self.config)

    def refuses(self, scene: Scene, proposal: MetaActionProposal) -> Reason | None:
        """Reason if the proposal is invalid or the scene is not finite; else None."""
        return self.screen.refuses(scene, proposal)

    def observe(self, memory: Memory[Sequel], scene: Scene) -> tuple[ObservedScene, Memory[Sequel]]:
        """Observe a scene: monitor, and reachable places of the others."""
        rollouts = Rollouts(scene.dt, scene.road)

        def fail_safe(verifier: PathVerifier) -> FloatArray:
            # Without a brake, the fail-safe is the slowest sequence of actions.
            candidates, _ = meta_candidates(scene, [slower(scene.control.actions)], self.config.horizon)
            paths = candidates.paths(rollouts, scene.ego_road)
            return verifier.of_each(verifier.clearance(paths, candidates.lanes, candidates.fails))

        now = observe(memory, scene, self.config, scene.frames_per_decision, fail_safe)
        return now, now.memory

    def plans(self, now: ObservedScene, proposal: MetaActionProposal) -> Iterator[JudgedPlan[Sequel]]:
        """The proposal, and then the alternatives in order."""
        scene = now.scene
        target = scene.target_of(proposal.action)
        if self.screen.buffer.objects(scene, target):
            reason = Reason.BUFFER
        else:
            yield JudgedPlan(Tier.PASSED, Reason.NONE, self._judge(now, [proposal.action])[0])
            reason = self.screen.why(scene, target)
        for plan in self._judge(now, self._others(scene, proposal)):
            yield JudgedPlan(Tier.ALTERNATIVE, reason, plan)

    def fall_back(
        self, now: ObservedScene, proposal: MetaActionProposal, tried: list[JudgedPlan[Sequel]]
    ) -> JudgedPlan[Sequel]:
        """The stored sequence, unless there is a violation. Else the plan that stays clear longest, then with the
        largest margin, then the slowest."""
        reason, scene = Reason.NO_SAFE_PLAN, now.scene
        if (now.memory.stored and not now.memory.watch.violated) or not tried:
            tier, plan = self.last_resort(now.memory, scene, proposal)
            return JudgedPlan(tier, reason, plan)
        # The proposal comes last, because `max` takes the first of equal plans.
        plans = sorted((each.plan for each in tried), key=lambda plan: plan.action == proposal.action)
        plan = max(plans, key=lambda x: (x.clear, x.margin, -scene.target_of(x.action).speed))
        return JudgedPlan(Tier.LARGEST_MARGIN, reason, plan)

    def last_resort(
        self, memory: Memory[Sequel], scene: Scene | Unreadable, proposal: MetaActionProposal
    ) -> tuple[Tier, Plan[Sequel]]:
        """The next action of the stored sequence, or SLOWER."""
        if memory.stored:
            return Tier.STORED_PLAN, Plan(memory.stored[0], stored=memory.stored[1:])
        return Tier.EMERGENCY, Plan(slower(proposal.labels), stored=memory.stored)

    def _others(self, scene: Scene, proposal: MetaActionProposal) -> list[int]:
        """The alternatives in order of preference, without those that the buffer rule refuses."""
        targets = [scene.target_of(a) for a in range(len(scene.control.actions))]
        wanted = resolve(proposal.order)
        if wanted is None:
            wanted = default_order(scene, proposal.action, targets)
        return [
            a
            for a in wanted
            if a != proposal.action
            and targets[a] != targets[proposal.action]
            and not self.screen.buffer.objects(scene, targets[a])
        ]

    def _judge(self, now: ObservedScene, actions: Sequence[int]) -> list[Plan[Sequel]]:
        """The plan of each first action: that action and its sequence."""
        if not actions:
            return []
        scene = now.scene
        candidates, sequences = meta_candidates(scene, list(actions), self.config.horizon)
        paths, result = now.judge(candidates)
        occupancy = None
        if self.config.record:
            occupancy = now.verifier.around.occupancy(paths.shape[1]).rectangles()
        out = []
        for i, action in enumerate(actions):
            path, left = np.vstack([scene.ego_road, paths[i]]), sequences[i][1:]
            clear = int(result.clear[i])
            out.append(Plan(action, float(result.margin[i]), left, path, result.binding(i), clear, occupancy))
        return out
