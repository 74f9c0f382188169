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
    clip : whether the environment cuts actions down to [-1, 1].
    """

    acceleration: tuple[float, float] = (-5.0, 5.0)
    steering: tuple[float, float] = (-float(np.pi / 4), float(np.pi / 4))
    longitudinal: bool = True
    lateral: bool = True
    clip: bool = True

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
            bool(action_type.clip),
        )

    @property
    def size(self) -> int:
        """Entries of an action."""
        return int(self.longitudinal) + int(self.lateral)

    def read(self, action: Any) -> FloatArray | None:
        """One normalised action (size,), clipped to [-1, 1] where the environment does so; None where it is not one.

        Examples
        --------
        >>> Actuators().read([2.0, 0.5]), Actuators().read([np.nan, 0.0]), Actuators().read([0.1])
        (array([1. , 0.5]), None, None)
        """
        try:
            array = np.asarray(action, dtype=float)
        except (TypeError, ValueError, OverflowError):
            return None
        if array.shape != (self.size,) or not np.isfinite(array).all():
            return None
        clipped = np.clip(array, -1.0, 1.0)
        # An environment that does not clip would carry out more than the actuators' range.
        return clipped if self.clip or np.array_equal(clipped, array) else None

    def physical(self, action: FloatArray) -> FloatArray:
        """(acceleration [m/s^2], front wheel angle [rad]) of normalised actions, (..., size) to (..., 2).

        What is not controlled is zero. Source: `ContinuousAction.get_action` of highway-env 1.12.
        """
        action = np.asarray(action, dtype=float)
        out = np.zeros((*action.shape[:-1], 2))
        for column, (i, limits) in enumerate(self._columns()):
            out[..., i] = _map(action[..., column], (-1.0, 1.0), limits)
        return out

    def normalised(self, inputs: FloatArray) -> Any:
        """The normalised actions nearest to physical inputs, (..., 2) to (..., size) float32."""
        parts = [_map(inputs[..., i], limits, (-1.0, 1.0)) for i, limits in self._columns()]
        return np.clip(np.stack(parts, axis=-1), -1.0, 1.0).astype(np.float32)

    def _columns(self) -> list[tuple[int, tuple[float, float]]]:
        both = ((self.longitudinal, self.acceleration), (self.lateral, self.steering))
        return [(i, limits) for i, (there, limits) in enumerate(both) if there]


def _map(value: Any, x: tuple[float, float], y: tuple[float, float]) -> Any:
    return y[0] + (value - x[0]) * (y[1] - y[0]) / (x[1] - x[0])
