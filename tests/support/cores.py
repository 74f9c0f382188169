"""Procedures with their memory, driven scene by scene in the tests."""

from __future__ import annotations

from dataclasses import replace
from inspect import signature
from typing import Any

import numpy as np

from dynamics.vehicle.actuators import Actuators
from shield import Decision, ShieldConfig, Tier
from shield.certificate.road.memory import ObservedScene
from shield.pipelines.decide import DecisionCore
from shield.pipelines.frames import FramePipeline
from shield.pipelines.inputs import InputPipeline
from shield.pipelines.meta_actions import MetaActionPipeline
from shield.pipelines.meta_actions_only import UnsupervisedMetaActionPipeline
from shield.pipelines.nearest_inputs import NearestInputs
from shield.pipelines.parking_lot import ParkingLotPipeline
from shield.pipelines.screen import MetaActionProposal, RulePipeline

__all__ = ["ContinuousCore", "LotCore", "MetaCore", "ShieldCore", "nowhere"]


def nowhere(judged: Any) -> Any:
    """`judged`, for which it is not known where the others can be: their states are NaN."""
    place = list(signature(judged.py_func).parameters).index("scene")

    def unknown(*args: Any) -> Any:
        scene = args[place]
        vehicles = scene.vehicles._replace(states=scene.vehicles.states * np.nan)
        return judged(*args[:place], scene._replace(vehicles=vehicles), *args[place + 1 :])

    return unknown


class _Driven:
    core: DecisionCore[Any]

    def prepare(self, scene: Any) -> None:
        self.core.procedure.prepare(scene)

    def reset(self) -> None:
        self.core.reset()

    @property
    def watch(self) -> Any:
        return self.core.memory.watch

    @property
    def violations(self) -> int:
        return self.core.violations

    @property
    def stored(self) -> Any:
        return self.core.memory.stored

    @stored.setter
    def stored(self, value: Any) -> None:
        self.core.memory = replace(self.core.memory, stored=value)

    def observe(self, scene: Any) -> ObservedScene:
        """Take a scene in."""
        now, self.core.memory = self.core.procedure.observe(self.core.memory, scene)
        return now

    def filter(self, scene: Any, proposal: Any) -> tuple[Any, Decision]:
        decision = self.core.decide(scene, proposal)
        return decision.executed, decision


class ShieldCore(_Driven):
    """Meta-actions and the frames between them, as behind `ShieldedEnv`."""

    def __init__(self, config: ShieldConfig | None = None) -> None:
        self.config = config or ShieldConfig()
        self.meta = MetaActionPipeline(self.config)
        self.frames = FramePipeline(self.config, NearestInputs(self.config) if self.config.repair == "filter" else None)
        rule = self.config.mode not in ("none", "full")
        self.core = DecisionCore(RulePipeline(self.config) if rule else self.meta)

    def decide(self, scene: Any, action: int, order: Any = None) -> Decision:
        return self.core.decide(scene, MetaActionProposal(action, scene.control.actions, order))

    def supervise(self, scene: Any) -> tuple[Any, Decision]:
        decision = self.core.decide(scene, scene.control.target, self.frames)
        return None if decision.tier is Tier.PASSED else decision.executed, decision

    def mask(self, scene: Any) -> Any:
        return self.meta.mask(self.core.memory, scene)


class MetaCore(_Driven):
    """Meta-actions only, as behind `Shield`."""

    def __init__(self, config: ShieldConfig | None = None) -> None:
        self.core = DecisionCore(UnsupervisedMetaActionPipeline(config))

    def decide(self, scene: Any, action: int, order: Any = None) -> Decision:
        return self.core.decide(scene, MetaActionProposal(action, scene.control.actions, order))


class ContinuousCore(_Driven):
    """Throttle and steering on a road."""

    def __init__(
        self,
        config: ShieldConfig | None = None,
        actuators: Actuators | None = None,
        predictive: bool = True,
        hold: int | None = None,
        **more: Any,
    ) -> None:
        self.inputs = InputPipeline(config or ShieldConfig(), actuators or Actuators(), hold, predictive, **more)
        self.core = DecisionCore(self.inputs)

    def judge(self, scene: Any, inputs: np.ndarray, lanes: list[int]) -> Any:
        return self.inputs.judge(self.observe(scene), inputs, lanes)


class LotCore(_Driven):
    """Throttle and steering in a parking lot."""

    def __init__(
        self, config: ShieldConfig | None = None, actuators: Actuators | None = None, period: int | None = None
    ) -> None:
        self.procedure = ParkingLotPipeline(config or ShieldConfig(), actuators, period)
        self.core = DecisionCore(self.procedure)

    def judge(self, lot: Any, inputs: np.ndarray) -> Any:
        return self.procedure.judge(lot, inputs)

    def brake(self, lot: Any) -> np.ndarray:
        """The inputs of the last resort."""
        return self.procedure.last_resort(self.core.memory, lot, None)[1].action
