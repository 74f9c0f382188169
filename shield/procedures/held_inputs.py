"""The procedure for an agent with a throttle and a wheel only: what `Shield.predict` runs, once per decision.

As `shield.procedures.inputs`, but an input is held for the whole decision period, and so is each step of the fail-safe,
which may use no more than the actuators' own ranges. Without a throttle the ego cannot stop, and the certificate
reaches only as far as `ShieldConfig.horizon`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from dynamics.scenes.scene import Scene
from dynamics.state import FloatArray, RoadState
from dynamics.vehicle.actuators import Actuators
from dynamics.vehicle.held_rollouts import HeldRollouts
from shield.certificate.verify import Surveyor
from shield.config import ShieldConfig
from shield.procedures.inputs import ContinuousCore
from shield.repair.nearest_input import Judged

__all__ = ["AgentCore"]


class AgentCore(ContinuousCore):
    """Filters throttle and steering at decisions only, within the actuators' ranges.

    Parameters
    ----------
    config : settings; `braking` is cut down to what the throttle offers.
    actuators : what the policy controls.
    hold : simulation frames in a decision period.
    predictive : whether the predictive filter takes part in the repair.
    """

    def __init__(self, config: ShieldConfig | None, actuators: Actuators, hold: int, predictive: bool = True) -> None:
        config = config if config is not None else ShieldConfig()
        brake = -actuators.acceleration[0] if actuators.longitudinal else 0.0
        self._stops = brake > 0
        if self._stops:
            config = replace(config, braking=min(config.braking, brake))
        super().__init__(config, actuators, predictive=predictive and actuators.size == 2)
        self._frames = hold
        self._held: dict[tuple[float, Any], HeldRollouts] = {}
        self._wheel = min(abs(x) for x in actuators.steering) if actuators.lateral else 0.0

    def _judge_inputs(
        self,
        scene: Scene,
        inputs: FloatArray,
        stops: list[int],
        parts: bool = False,
        survey: Surveyor | None = None,
    ) -> Judged:
        # What is verified is what the environment will make of the action, rounding included.
        exact = self.actuators.physical(self.actuators.normalised(inputs))
        return super()._judge_inputs(scene, exact, stops, parts, survey)

    def _stopped(self, scene: Scene, began: FloatArray, fails: Any) -> FloatArray:
        key = scene.dt, getattr(scene.road, "profile", None)
        if key not in self._held:
            self._held[key] = HeldRollouts(scene.dt, self._frames, scene.road)
        period = self._frames * scene.dt
        if self._stops:
            top = max(float(began[:, -1, RoadState.SPEED].max()), 0.0)
            periods = int(np.ceil(top / (self.config.braking * period))) + 1
        else:
            periods = int(np.ceil(self.config.horizon / period))
        stops = np.empty((len(fails), 3))
        stops[:, 0] = scene.road.centers[fails]
        stops[:, 1], stops[:, 2] = self.config.braking if self._stops else 0.0, self._wheel
        began = np.repeat(began, len(fails) // len(began), axis=0)
        return np.concatenate([began, self._held[key].run(began[:, -1], stops, periods)], axis=1)

    def _law(self, scene: Scene, lane: int) -> FloatArray:
        brake, wheel = super()._law(scene, lane)
        return np.array([brake if self._stops else 0.0, np.clip(wheel, -self._wheel, self._wheel)])
