"""Speed recovery for a policy without a throttle."""

from __future__ import annotations

import numpy as np

from dynamics.state import FloatArray
from dynamics.vehicle.actuators import Actuators
from dynamics.vehicle.controllers import KP_SPEED

__all__ = ["SpeedRecovery"]

_SAME_SPEED = 1e-3
"""Speeds that differ by less count as equal [m/s]."""


class SpeedRecovery:
    """Brings the ego of a policy that only steers back to its speed before the shield braked.

    Parameters
    ----------
    actuators : the policy's actuators.
    """

    def __init__(self, actuators: Actuators) -> None:
        self._actuators = actuators
        self._speed: float | None = None

    def reset(self) -> None:
        """Clear the speed."""
        self._speed = None

    def proposal(self, inputs: FloatArray, speed: float) -> FloatArray:
        """Inputs (acceleration, wheel), (2,): the policy's, with an acceleration towards the former speed if `speed`
        [m/s] differs from it."""
        if self._actuators.longitudinal:
            return inputs
        if self._speed is None:
            self._speed = speed
        if abs(speed - self._speed) < _SAME_SPEED:
            return inputs
        low, high = self._actuators.acceleration
        return np.array([np.clip(KP_SPEED * (self._speed - speed), low, high), inputs[1]])
