"""Repair of a frame of a meta-action: the verified inputs nearest to those of the environment's own controllers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from dynamics.scenes.scene import Target
from dynamics.state import State
from dynamics.vehicle.controllers import speed_control, steering_control
from shield.certificate.road.memory import ObservedScene
from shield.config import ShieldConfig
from shield.pipelines.decide import Plan
from shield.pipelines.frames import FrameCommand
from shield.pipelines.inputs import InputPipeline

__all__ = ["NearestInputs"]


class NearestInputs:
    """A `Repair` of `FramePipeline`. Distance is measured in acceleration: in shares of the input ranges the ego would
    swerve.

    Parameters
    ----------
    config : settings.
    """

    def __init__(self, config: ShieldConfig) -> None:
        self._inputs = InputPipeline(config, norm="acceleration")

    def plans(self, now: ObservedScene, target: Target) -> Iterator[Plan[int]]:
        """The nearest inputs, and then those of the predictive filter."""
        scene = now.scene
        wheel = steering_control(scene.ego_road, scene.road.centers[target.lane])
        wanted = np.array([float(speed_control(scene.ego[State.SPEED], target.speed)), float(wheel)])
        first = self._inputs.judge(now, wanted[None], self._inputs.stop_lanes(now))
        for plan in self._inputs.repairs(now, wanted, first):
            command = FrameCommand(target.lane, float(plan.action[0]), float(plan.action[1]))
            path = None if plan.path is None else plan.path[1:]
            yield replace(plan, action=command, path=path)
