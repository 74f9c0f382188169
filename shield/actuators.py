"""Throttle and steering in the environment's own normalised units, and in physical ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.state import FloatArray

__all__ = ["Actuators"]


@dataclass(frozen=True, slots=True)
class Actuators:
    """What one highway-env `ContinuousAction` controls.

    Attributes
    ----------
    acceleration : accelerations [m/s^2] that -1 and 1 stand for.
    steering : front wheel angles [rad] that -1 and 1 stand for.
    longitudinal, lateral : whether there is a throttle, a steering wheel.
    """

    acceleration: tuple[float, float] = (-5.0, 5.0)
    steering: tuple[float, float] = (-float(np.pi / 4), float(np.pi / 4))
    longitudinal: bool = True
    lateral: bool = True

    @classmethod
    def of(cls, action_type: Any) -> Actuators:
        """Read a `ContinuousAction`."""
        low, high = action_type.acceleration_range
        left, right = action_type.steering_range
        return cls(
            (float(low), float(high)),
            (float(left), float(right)),
            bool(action_type.longitudinal),
            bool(action_type.lateral),
        )

    @property
    def size(self) -> int:
        """Entries of an action."""
        return int(self.longitudinal) + int(self.lateral)

    def read(self, action: Any) -> FloatArray | None:
        """One normalised action as floats, clipped to [-1, 1] as highway-env does; None where it is not one.

        Examples
        --------
        >>> Actuators().read([2.0, 0.5]), Actuators().read([np.nan, 0.0]), Actuators().read([0.1])
        (array([1. , 0.5]), None, None)
        """
        try:
            array = np.asarray(action, dtype=float).reshape(-1)
        except (TypeError, ValueError, OverflowError):
            return None
        if array.size != self.size or not np.isfinite(array).all():
            return None
        return np.clip(array, -1.0, 1.0)

    def physical(self, action: FloatArray) -> FloatArray:
        """(acceleration [m/s^2], front wheel angle [rad]) of a normalised action.

        Source: `utils.lmap` as `ContinuousAction.get_action` of highway-env 1.12 uses it.
        """
        parts = iter(action)
        a = _map(next(parts), (-1.0, 1.0), self.acceleration) if self.longitudinal else 0.0
        delta = _map(next(parts), (-1.0, 1.0), self.steering) if self.lateral else 0.0
        return np.array([a, delta])

    def normalised(self, inputs: FloatArray) -> FloatArray:
        """The normalised action nearest to physical inputs (2,), as float32."""
        parts = []
        if self.longitudinal:
            parts.append(_map(inputs[0], self.acceleration, (-1.0, 1.0)))
        if self.lateral:
            parts.append(_map(inputs[1], self.steering, (-1.0, 1.0)))
        return np.clip(np.array(parts), -1.0, 1.0).astype(np.float32)


def _map(value: Any, x: tuple[float, float], y: tuple[float, float]) -> float:
    return float(y[0] + (value - x[0]) * (y[1] - y[0]) / (x[1] - x[0]))
