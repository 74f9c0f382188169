"""Throttle and steering in the environment's normalised units, and in physical units."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.state import FloatArray

__all__ = ["Actuators"]


@dataclass(frozen=True, slots=True)
class Actuators:
    """The actuators of a highway-env `ContinuousAction`, or of a `DiscreteAction`, which selects from the same inputs.

    Attributes
    ----------
    acceleration : accelerations [m/s^2] for the inputs -1 and 1.
    steering : front wheel angles [rad] for the inputs -1 and 1.
    longitudinal, lateral : whether there is a throttle, a steering wheel.
    clip : whether the environment clips actions to [-1, 1].
    choices : for a `DiscreteAction`, the normalised inputs of each action number, (actions, size); else None.
    """

    acceleration: tuple[float, float] = (-5.0, 5.0)
    steering: tuple[float, float] = (-float(np.pi / 4), float(np.pi / 4))
    longitudinal: bool = True
    lateral: bool = True
    clip: bool = True
    choices: FloatArray | None = None

    @classmethod
    def of(cls, action_type: Any) -> Actuators:
        """Read a `ContinuousAction` or a `DiscreteAction`. An attribute `inputs`, (actions, size), of the action type
        defines `choices`."""
        low, high = action_type.acceleration_range
        left, right = action_type.steering_range
        return cls(
            (float(low), float(high)),
            (float(left), float(right)),
            bool(action_type.longitudinal),
            bool(action_type.lateral),
            bool(action_type.clip),
            _choices(action_type),
        )

    @property
    def size(self) -> int:
        """Number of inputs."""
        return int(self.longitudinal) + int(self.lateral)

    @property
    def entries(self) -> int:
        """Number of entries of an action: 1 if there are `choices`."""
        return self.size if self.choices is None else 1

    def read(self, action: Any) -> FloatArray | None:
        """The normalised inputs (size,) of an action, clipped to [-1, 1] if the environment does so; None if it is no
        valid action.

        Examples
        --------
        >>> Actuators().read([2.0, 0.5]), Actuators().read([np.nan, 0.0]), Actuators().read([0.1])
        (array([1. , 0.5]), None, None)
        """
        try:
            array = np.asarray(action, dtype=float)
        except (TypeError, ValueError, OverflowError):
            return None
        if self.choices is not None:
            whole = array.size == 1 and np.isfinite(array).all() and array.item() == np.rint(array.item())
            return self.choices[int(array.item())] if whole and 0 <= array.item() < len(self.choices) else None
        if array.shape != (self.size,) or not np.isfinite(array).all():
            return None
        clipped = np.clip(array, -1.0, 1.0)
        # An environment that does not clip would apply inputs beyond the actuators' range.
        return clipped if self.clip or np.array_equal(clipped, array) else None

    def physical(self, action: FloatArray) -> FloatArray:
        """(acceleration [m/s^2], front wheel angle [rad]) of normalised actions, (..., size) to (..., 2).

        Missing inputs are zero. Source: `ContinuousAction.get_action` of highway-env 1.12.
        """
        action = np.asarray(action, dtype=float)
        out = np.zeros((*action.shape[:-1], 2))
        for column, (i, limits) in enumerate(self._columns()):
            out[..., i] = _map(action[..., column], (-1.0, 1.0), limits)
        return out

    def normalised(self, inputs: FloatArray) -> Any:
        """The actions nearest to physical inputs, (..., 2): normalised ones, (..., size) float32, or action numbers,
        (...)."""
        parts = [_map(inputs[..., i], limits, (-1.0, 1.0)) for i, limits in self._columns()]
        exact = np.clip(np.stack(parts, axis=-1), -1.0, 1.0)
        if self.choices is None:
            return exact.astype(np.float32)
        return np.abs(self.choices - exact[..., None, :]).sum(axis=-1).argmin(axis=-1)

    def _columns(self) -> list[tuple[int, tuple[float, float]]]:
        both = ((self.longitudinal, self.acceleration), (self.lateral, self.steering))
        return [(i, limits) for i, (there, limits) in enumerate(both) if there]


def _choices(action_type: Any) -> FloatArray | None:
    """The inputs of a `DiscreteAction`: evenly spaced on each axis, the last axis changing fastest."""
    own = getattr(action_type, "inputs", None)
    count = getattr(action_type, "actions_per_axis", None)
    if own is not None or count is None:
        return None if own is None else np.asarray(own, dtype=float)
    steps = np.linspace(-1.0, 1.0, int(count))
    return np.stack(np.meshgrid(*[steps] * action_type.size, indexing="ij"), axis=-1).reshape(-1, action_type.size)


def _map(value: Any, x: tuple[float, float], y: tuple[float, float]) -> Any:
    return y[0] + (value - x[0]) * (y[1] - y[0]) / (x[1] - x[0])
