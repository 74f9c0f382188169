"""Execution of an input: the duration for which it is held, and the braking of the fail-safe after it.

An input is acceleration [m/s^2] and front wheel angle [rad]. In `ShieldedEnv` the shield acts at every frame. In
`Shield` an input is held for the whole decision period. Each step of the fail-safe is held as long, within the
actuators' own ranges. Without a throttle the ego cannot stop then, and the certificate covers `ShieldConfig.horizon`
only.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from dynamics.scenes.scene import Scene
from dynamics.state import FloatArray, RoadState, State
from dynamics.vehicle.actuators import Actuators
from dynamics.vehicle.braking_rollouts import BrakingRollouts
from dynamics.vehicle.curved_bicycle import steer
from dynamics.vehicle.rollouts import Rollouts
from shield.config import ShieldConfig

__all__ = ["EveryDecision", "EveryFrame", "Execution"]


class Execution(Protocol):
    """Execution of inputs.

    Attributes
    ----------
    config : the shield's settings, with the braking that is available. frames : number of frames for which an input is
        held.
    """

    config: ShieldConfig
    frames: int

    def exact(self, inputs: FloatArray) -> FloatArray:
        """Inputs (n, 2) as the environment will apply them."""

    def stops(self, scene: Scene, began: FloatArray, fails: Any) -> FloatArray:
        """Paths (n, h, 4), each followed by its fail-safes in lanes `fails` (n k,): (n k, h + frames, 4)."""

    def fail_safe_inputs(self, scene: Scene, lane: int) -> FloatArray:
        """Inputs of the fail-safe's next step (2,): brake, and steer to the lane's centre."""


class EveryFrame:
    """The shield acts at every frame, with throttle, brake and wheel.

    Parameters
    ----------
    config : settings.
    """

    frames = 1

    def __init__(self, config: ShieldConfig) -> None:
        self.config = config

    def exact(self, inputs: FloatArray) -> FloatArray:
        """The inputs unchanged."""
        return inputs

    def stops(self, scene: Scene, began: FloatArray, fails: Any) -> FloatArray:
        """Stops at `config.braking`."""
        top = max(float(began[:, -1, RoadState.SPEED].max()), 0.0)
        frames = int(np.ceil(top / (self.config.braking * scene.dt))) + 1
        rollouts = Rollouts(scene.dt, scene.road)
        return rollouts.stop(began, scene.road.centers[fails], self.config.braking, frames)

    def fail_safe_inputs(self, scene: Scene, lane: int) -> FloatArray:
        """Braking at `config.braking`, or less if that suffices to stop."""
        return _brake(scene, lane, self.config.braking, scene.dt)


class EveryDecision:
    """The shield acts through the actions, once per decision.

    Parameters
    ----------
    config : settings; `braking` is limited to the range of the throttle.
    actuators : the policy's actuators.
    hold : simulation frames in a decision period.
    """

    def __init__(self, config: ShieldConfig, actuators: Actuators, hold: int) -> None:
        brake = -actuators.acceleration[0] if actuators.longitudinal else 0.0
        self._can_stop, self._actuators = brake > 0, actuators
        self.config = replace(config, braking=min(config.braking, brake)) if self._can_stop else config
        self.frames = hold
        self._wheel = min(abs(x) for x in actuators.steering) if actuators.lateral else 0.0

    def exact(self, inputs: FloatArray) -> FloatArray:
        """The inputs that result from the normalised actions, rounding included."""
        return self._actuators.physical(self._actuators.normalised(inputs))

    def stops(self, scene: Scene, began: FloatArray, fails: Any) -> FloatArray:
        """Braking in steps of a decision period, to a stop or up to the horizon."""
        period, braking = self.frames * scene.dt, self.config.braking
        if self._can_stop:
            top = max(float(began[:, -1, RoadState.SPEED].max()), 0.0)
            periods = int(np.ceil(top / (braking * period))) + 1
        else:
            periods = int(np.ceil(self.config.horizon / period))
        stops = np.empty((len(fails), 3))
        stops[:, 0] = scene.road.centers[fails]
        stops[:, 1], stops[:, 2] = braking if self._can_stop else 0.0, self._wheel
        began = np.repeat(began, len(fails) // len(began), axis=0)
        repeated = BrakingRollouts(scene.dt, self.frames, scene.road)
        return np.concatenate([began, repeated.run(began[:, -1], stops, periods)], axis=1)

    def fail_safe_inputs(self, scene: Scene, lane: int) -> FloatArray:
        """Braking within the range of the throttle, the wheel within its range."""
        brake, wheel = _brake(scene, lane, self.config.braking, self.frames * scene.dt)
        return np.array([brake if self._can_stop else 0.0, np.clip(wheel, -self._wheel, self._wheel)])


def _brake(scene: Scene, lane: int, braking: float, period: float) -> FloatArray:
    """Inputs that brake at most at `braking` [m/s^2], and stop the ego within `period` [s] if they can, (2,)."""
    wheel = steer(scene.road, scene.ego_road, scene.road.centers[lane], scene.dt)
    v = float(scene.ego[State.SPEED])
    return np.array([max(-braking, -v / period) if v >= 0 else min(-v / period, braking), wheel])
