"""The procedure for meta-actions only: what `Shield.predict` runs, once per decision.

Without a brake of its own, the fail-safe is a sequence of meta-actions: each action, a lane change among them, and
then SLOWER to the end. Where the ego's slowest target speed is above zero it cannot stop, and a
sequence is verified over `ShieldConfig.horizon` only: that is what its certificate says, and no more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from dynamics.scenes.scene import Scene
from dynamics.state import FloatArray
from dynamics.traffic.occupancy import Surroundings
from dynamics.vehicle.rollouts import Rollouts
from shield.certificate.manoeuvres import meta_candidates
from shield.certificate.monitor import AssumptionMonitor
from shield.certificate.verify import Surveyor
from shield.config import ShieldConfig
from shield.decision import Decision, Reason, Tier
from shield.procedures.screen import Screen, slower
from shield.repair.order import Order, default_order, resolve

__all__ = ["MetaCore"]


@dataclass(frozen=True, slots=True)
class _Best:
    """The sequence that starts with one action: margin [m], frames that stay clear, actions, path."""

    margin: float
    clear: int
    sequence: tuple[int, ...]
    path: FloatArray
    occupancy: FloatArray | None


class MetaCore:
    """Holds the memory of one vehicle that is shielded at its decisions only.

    Parameters
    ----------
    config : settings; `ShieldConfig.for_meta_actions()` by default.
    """

    def __init__(self, config: ShieldConfig | None = None) -> None:
        self.config = config if config is not None else ShieldConfig.for_meta_actions()
        self._rollouts: dict[float, Rollouts] = {}
        self._screen = Screen(self.config)
        self.reset()

    def reset(self) -> None:
        """Forget everything about the episode."""
        self.monitor = AssumptionMonitor(self.config)
        self._stored: tuple[int, ...] = ()
        self._surveyor: Surveyor | None = None

    def decide(self, scene: Scene, proposed: int, order: Order = None) -> Decision:
        """Choose the meta-action for the next decision period.

        Parameters
        ----------
        scene : the scene now.
        proposed : the policy's action index.
        order : the alternatives in the policy's order of preference, or a function that gives it;
            `default_order` without one.
        """
        start = perf_counter()
        labels = scene.control.actions
        screened = self._screen.decide(scene, proposed, self.fallback, start)
        if screened is not None:
            return screened
        target = scene.target_of(proposed)
        self._observe(scene)
        if self._screen.buffer.objects(scene, target):
            reason, best = Reason.BUFFER, None
        else:
            best = self._best(scene, [proposed])[proposed]
            if best.margin >= 0:
                return self._made(scene, proposed, proposed, Reason.NONE, Tier.PASSED, best, start)
            reason = self._screen.why(scene, target)
        targets = [scene.target_of(a) for a in range(len(labels))]
        wanted = resolve(order)
        if wanted is None:
            wanted = default_order(scene, proposed, targets)
        others = [
            a
            for a in wanted
            if a != proposed and targets[a] != target and not self._screen.buffer.objects(scene, targets[a])
        ]
        results = self._best(scene, others) if others else {}
        for action in others:
            if results[action].margin >= 0:
                return self._made(scene, proposed, action, reason, Tier.ALTERNATIVE, results[action], start)
        if self._stored and not self.monitor.violated:
            return self.fallback(labels, proposed, Reason.NO_SAFE_PLAN, start)
        if best is not None:
            results[proposed] = best
        if not results:
            return self.fallback(labels, proposed, Reason.NO_SAFE_PLAN, start)
        # The one that stays clear longest, then the largest margin, then the slowest.
        action = max(results, key=lambda a: (results[a].clear, results[a].margin, -targets[a].speed))
        return self._made(
            scene,
            proposed,
            action,
            Reason.NO_SAFE_PLAN,
            Tier.LARGEST_MARGIN,
            results[action],
            start,
        )

    def _observe(self, scene: Scene) -> None:
        a = self.config.assumptions
        around = Surroundings(scene.others, scene.others_road, scene.road, a, scene.dt)
        survey = self._surveyor = Surveyor(scene, self.config, around=around)
        period = scene.frames_per_decision * scene.dt

        def fail_safe() -> FloatArray:
            # The ego has no brake: what counts is the room for the slowest that its actions allow.
            candidates, _ = meta_candidates(scene, [slower(scene.control.actions)], self.config.horizon)
            paths = self._rollouts_for(scene).run(scene.ego_road, candidates.commands)
            return survey.of_each(survey.clearance(paths, candidates))

        self.monitor.update(scene, around, survey.others.behind, survey.others.held, period, fail_safe)

    def _rollouts_for(self, scene: Scene) -> Rollouts:
        if scene.dt not in self._rollouts:
            self._rollouts[scene.dt] = Rollouts(scene.dt)
        return self._rollouts[scene.dt]

    def fallback(self, labels: Sequence[str], proposed: Any, reason: Reason, start: float) -> Decision:
        """Play the stored sequence on, or slow down; used when there is no proposal to verify."""
        if self._stored:
            action, self._stored = self._stored[0], self._stored[1:]
            tier = Tier.STORED_PLAN
        else:
            action, tier = slower(labels), Tier.EMERGENCY
        return Decision(proposed, action, reason, tier, np.nan, perf_counter() - start)

    def _best(self, scene: Scene, actions: Sequence[int]) -> dict[int, _Best]:
        """For each first action: the margin [m] of its one sequence, its path, and the occupancy if recorded."""
        candidates, sequences = meta_candidates(scene, list(actions), self.config.horizon)
        paths = self._rollouts_for(scene).run(scene.ego_road, candidates.commands)
        surveyor = self._surveyor if self._surveyor is not None else Surveyor(scene, self.config)
        result = surveyor.clearance(paths, candidates)
        occupancy = None
        if self.config.record:
            occupancy = surveyor.around.occupancy(paths.shape[1], scene.dt).rectangles()
        return {
            a: _Best(float(result.margin[i]), int(result.clear[i]), sequences[i], paths[i], occupancy)
            for i, a in enumerate(actions)
        }

    def _made(
        self,
        scene: Scene,
        proposed: int,
        executed: int,
        reason: Reason,
        tier: Tier,
        best: _Best,
        start: float,
    ) -> Decision:
        self._stored = best.sequence[1:] if tier is not Tier.LARGEST_MARGIN else ()
        plan = np.vstack([scene.ego_road, best.path])
        latency = perf_counter() - start
        return Decision(proposed, executed, reason, tier, best.margin, latency, plan, best.occupancy)
