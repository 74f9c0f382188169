"""How a frame of a meta-action that has become unsafe is mended: by the predictive filter.

`ShieldCore` itself holds the meta-action back: the greatest acceleration that verifies, in the committed lane if it
can.
"""

from __future__ import annotations

from time import perf_counter

import numpy as np

from dynamics.scenes.scene import Scene
from dynamics.state import State
from dynamics.vehicle.controllers import speed_control, steering_control
from shield.config import ShieldConfig
from shield.decision import Tier
from shield.procedures.frames import FrameCommand, Verdict
from shield.procedures.inputs import ContinuousCore
from shield.procedures.meta_actions import ShieldCore

__all__ = ["FilteringCore", "make_core"]


class FilteringCore(ContinuousCore, ShieldCore):
    """Takes the verified inputs that are nearest to those of the environment's own controllers."""

    @property
    def norm(self) -> str:
        """By acceleration: in shares of the ranges, the repair of a meta-action would swerve."""
        return "acceleration"

    def _mend(self, scene: Scene) -> tuple[FrameCommand, Verdict]:
        start, target = perf_counter(), scene.control.target
        wheel = steering_control(scene.ego_road, scene.road.centers[target.lane])
        wanted = np.array([float(speed_control(scene.ego[State.SPEED], target.speed)), float(wheel)])
        stored = self.stored_lane
        first = self._judge_inputs(scene, wanted[None], self._stop_lanes(scene))
        inputs, decision = self._repair_inputs(scene, wanted, first, start)
        command = FrameCommand(target.lane, float(inputs[0]), float(inputs[1]))
        if decision.tier is not Tier.GOVERNED or decision.plan is None:
            self.stored_lane = stored
            return command, Verdict(-np.inf, target.lane, np.empty((0, 4)))
        lane = self.stored_lane if self.stored_lane is not None else target.lane
        return command, Verdict(decision.margin, lane, decision.plan[1:])


def make_core(config: ShieldConfig) -> ShieldCore:
    """The core that `config.repair` asks for."""
    kinds = {"hold": ShieldCore, "filter": FilteringCore}
    if config.repair == "filter" and config.mode not in ("none", "full"):
        return ShieldCore(config)  # a rule alone supervises no frames
    return kinds[config.repair](config)
