"""A policy without a throttle: which speed it is owed."""

from __future__ import annotations

import numpy as np

from dynamics.state import FloatArray
from dynamics.vehicle.actuators import Actuators
from dynamics.vehicle.controllers import KP_SPEED

__all__ = ["Cruise"]

_SAME_SPEED = 1e-3
"""Speeds that count as the same [m/s]."""


class Cruise:
    """Brings the ego of a policy that only steers back to the speed that the shield has taken from it.

    Parameters
    ----------
    actuators : what the policy controls.
    """

    def __init__(self, actuators: Actuators) -> None:
        self._actuators = actuators
        self._speed: float | None = None

    def reset(self) -> None:
        """Forget the speed."""
        self._speed = None

    def proposal(self, inputs: FloatArray, speed: float) -> FloatArray:
        """The policy's inputs (acceleration, wheel), (2,), with what brings the ego back from a speed [m/s]."""
        if self._actuators.longitudinal:
            return inputs
        if self._speed is None:
            self._speed = speed
        if abs(speed - self._speed) < _SAME_SPEED:
            return inputs
        low, high = self._actuators.acceleration
        return np.array([np.clip(KP_SPEED * (self._speed - speed), low, high), inputs[1]])
