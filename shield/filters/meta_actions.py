"""The filter for `DiscreteMetaAction` on a straight highway: filters decisions, and supervises the frames between
them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from dynamics.scenes.scene import Scene, SceneReader, Target
from shield.config import RULES_ALONE, ShieldConfig
from shield.decision import Decision, Reason, Tier
from shield.environments import check_configuration, refuse_parking_lots
from shield.errors import SceneError
from shield.explaining.scenes import explain_scene
from shield.filters.discrete_action import action_index
from shield.filters.supervision import Command
from shield.perception.environment_free import EnvironmentFreeScenes
from shield.perception.scenes import ObservedScenes
from shield.pipelines.decide import DecisionCore, Unreadable, read
from shield.pipelines.frames import FramePipeline
from shield.pipelines.meta_actions import MetaActionPipeline
from shield.pipelines.meta_actions_only import UnsupervisedMetaActionPipeline
from shield.pipelines.nearest_inputs import NearestInputs
from shield.pipelines.screen import MetaActionProposal, RulePipeline
from shield.rules import Rule
from shield.supported_environments import refuse_simulated

__all__ = ["MetaActionFilter"]


class MetaActionFilter:
    """Filters the meta-actions of one environment.

    Parameters
    ----------
    base : the highway-env environment, unwrapped; None if it is in another process. Then `scenes` are the only source.
    config : settings.
    frames : whether the frames between two decisions are supervised, with `frame`. Without supervision a meta-action
        lasts until the next decision, and is verified over the horizon only.
    rule : a rule that decides alone, as in the modes of `RULES_ALONE`.
    scenes : scene reader; by default it reads the simulator's state.

    Raises
    ------
    SceneError
        If the environment's road or number of controlled vehicles is not supported.
    ConfigError
        If the environment is a parking lot, or its configuration is not supported.

    Attributes
    ----------
    core : decides, and holds the memory. cause : why the scene of the last decision could not be read; "" if it could.
    """

    def __init__(
        self,
        base: Any,
        config: ShieldConfig,
        frames: bool = True,
        rule: Rule | None = None,
        scenes: ObservedScenes | EnvironmentFreeScenes | None = None,
    ) -> None:
        if base is not None:
            refuse_parking_lots([base])
            check_configuration(base, config)
        refuse_simulated(config)
        self.config, self._base, self._scenes = config, base, scenes
        self.reader: SceneReader | ObservedScenes | EnvironmentFreeScenes = (
            SceneReader(base) if scenes is None else scenes
        )
        self._meta: Any = MetaActionPipeline(config) if frames else UnsupervisedMetaActionPipeline(config)
        self._frames = FramePipeline(config, NearestInputs(config) if config.repair == "filter" else None)
        self._alone = rule is not None or config.mode in RULES_ALONE
        self.core: DecisionCore[Any] = DecisionCore(
            RulePipeline(config, rule) if self._alone else self._meta, explain_scene
        )
        self._passed: tuple[Decision, Target] | None = None
        self.cause = ""
        if base is not None and base.road is not None and config.mode != "none":
            self._check()

    @property
    def violations(self) -> int:
        """Number of violations of the assumptions by the traffic."""
        return self.core.violations

    @property
    def by_rule(self) -> dict[str, int]:
        """The same by rule."""
        return self.core.by_rule

    @property
    def supervising(self) -> bool:
        """Whether `frame` is called between decisions."""
        return self.config.mode == "full" and not self._alone

    def record(self) -> None:
        """Keep in each decision the data for drawings, as with `ShieldConfig.record`."""
        self.config = self.config.replace(record=True)
        procedures: tuple[Any, ...] = (self._meta, self._frames, self.core.procedure)
        for procedure in procedures:
            procedure.config = self.config

    def reset(self) -> None:
        """Clear everything about the episode.

        Raises
        ------
        SceneError
            If the episode's road is not supported.
        ConfigError
            If the environment's present configuration is not supported.
        """
        if self._base is not None:
            check_configuration(self._base, self.config)
        self.core.reset()
        if self.config.mode != "none":
            self._check()
        self._passed = None

    def show(self, observation: Any) -> None:
        """Present the policy's observation before a decision. Without effect if scenes come from the simulator's
        state."""
        if self._scenes is not None and self.observing:
            self._scenes.show(observation)

    @property
    def observing(self) -> bool:
        """Whether scenes are made from observations."""
        return self._scenes is not None and self.config.mode != "none"

    def begins(self) -> bool:
        """Whether the last observation begins an episode that was not announced (`EnvironmentFreeScenes.begins`)."""
        return self.observing and isinstance(self._scenes, EnvironmentFreeScenes) and self._scenes.begins()

    def decide(self, action: Any, order: Callable[[], list[int] | None] | None = None) -> Decision:
        """Filter one meta-action; `order` returns the policy's order of preference over the others."""
        start, proposed, labels = perf_counter(), action_index(action), self.reader.actions
        shown = action if proposed < 0 else proposed
        self._passed = None
        if self.config.mode == "none":
            return Decision(shown, shown, Reason.NONE, Tier.OFF, np.nan, 0.0)
        scene = read(self.reader)
        self.cause = scene.cause if isinstance(scene, Unreadable) else ""
        decision = self.core.decide(scene, MetaActionProposal(proposed, labels, order))
        if decision.tier is Tier.PASSED and isinstance(scene, Scene):
            self._passed = replace(self._rated(decision, scene), latency=0.0), scene.target_of(proposed)
        if isinstance(self._scenes, EnvironmentFreeScenes):
            self._scenes.tell(int(decision.executed))
        return replace(self._rated(decision, scene), proposed=shown, latency=perf_counter() - start)

    def frame(self) -> tuple[Command, Decision]:
        """Command for the next frame, None to keep the environment's own; and the record."""
        passed, self._passed = self._passed, None
        if passed is not None and self._tracked() == passed[1]:
            # The decision has just verified this frame, with the same target command.
            return None, passed[0]
        scene = read(self.reader)
        stopping_target = Target(int(self._base.vehicle.lane_index[2]), 0.0)
        target = stopping_target if isinstance(scene, Unreadable) else scene.control.target
        decision = self._rated(self.core.decide(scene, target, self._frames), scene)
        return (None if decision.tier is Tier.PASSED else decision.executed), decision

    def monitor_last_frame(self) -> None:
        """Run the monitor on the last frame of an episode, after which there is no decision."""
        if self._scenes is None and self.config.mode != "none" and not self._alone:
            self.core.observe(read(self.reader), self._frames if self.supervising else None)

    def mask(self) -> np.ndarray[Any, Any]:
        """Mask of the actions that verify now; all True if none does."""
        mask: np.ndarray[Any, Any] = self._meta.mask(self.core.memory, self.reader.read())
        return mask if mask.any() else np.ones_like(mask)

    def _check(self) -> None:
        """Compute the road-dependent tables. An error names the settings that support meta-actions on this road."""
        try:
            self.reader.check()
        except SceneError as error:
            if self._base is None or self._base.road is None:
                raise
            # Imported here, because the simulation takes longer to import.
            from shield.filters.simulated.remedies import default_advice, simulation_advice

            instead = "; or ".join(each for each in (default_advice(self._base), simulation_advice(self._base)) if each)
            if not instead:
                raise
            raise SceneError(f"this road is not supported with these settings: {instead}. ({error})") from error

    def _rated(self, decision: Decision, scene: Any) -> Decision:
        """The decision with the guarantee of its perception."""
        if self._scenes is None or isinstance(scene, Unreadable):
            return decision
        perception = self._scenes.perception
        guarantee, level = perception.rating
        return replace(decision, scene_guarantee=guarantee, level=level, alarm=perception.alarmed)

    def _tracked(self) -> Target:
        """Target command that the ego's controllers track."""
        ego = self._base.vehicle
        return Target(int(ego.target_lane_index[2]), float(ego.target_speed))
