"""Continuous driving at highway speeds: the state of the ego, its observation, and random driving as training data.

The state has the six columns of `dynamics.learned.tasks.parking_state.Parking`, in SI units and the world frame:
position [m], velocity [m/s] and heading as (cos, sin). `OBSERVATION` is the highway-env observation of this state, for
any of its roads.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from dynamics.errors import ConfigError, DataError
from dynamics.state import FloatArray
from dynamics.vehicle.actuators import Actuators

__all__ = ["ACTION_DIM", "OBSERVATION", "STATE_DIM", "RandomDriver", "state"]

STATE_DIM, ACTION_DIM = 6, 2

OBSERVATION: Mapping[str, Any] = MappingProxyType(
    {
        "type": "Kinematics",
        "vehicles_count": 1,
        "features": ["x", "y", "vx", "vy", "cos_h", "sin_h"],
        "absolute": True,
        "normalize": False,
    }
)
"""Configuration of the observation that `state` reads."""

_FINE = 2.5
"""Random wheel angles are log-uniform, from 10^-_FINE of the greatest to the greatest."""


def state(observation: Any) -> FloatArray:
    """The ego's state in SI units, (6,), from an observation as configured in `OBSERVATION`.

    Raises
    ------
    DataError
        If it has another shape.

    Examples
    --------
    >>> state([[10.0, 4.0, 25.0, 0.0, 1.0, 0.0]]).tolist()
    [10.0, 4.0, 25.0, 0.0, 1.0, 0.0]
    """
    array = np.asarray(observation, dtype=float)
    if array.ndim != 2 or array.shape[0] < 1 or array.shape[1] != STATE_DIM:
        raise DataError(
            f"expected rows of {', '.join(OBSERVATION['features'])}, the ego first, shape (n, {STATE_DIM}); got shape "
            f"{array.shape}. Pass config={{'observation': dict(OBSERVATION)}} to gym.make"
        )
    found: FloatArray = array[0]
    return found


class RandomDriver:
    """Random throttle and steering between standstill and a top speed, each constant for some decisions.

    Accelerations are zero on average, so speeds vary slowly. Wheel angles are mostly the small ones of highway driving,
    and sometimes the greatest.

    Parameters
    ----------
    actuators : range of the normalised actions; both throttle and steering.
    dt : duration of a decision [s].
    generator : source of the random numbers.
    hold : inputs are constant for 1 to `hold` decisions.
    top : speed [m/s] up to which it accelerates.

    Raises
    ------
    ConfigError
        If a value is out of its range.
    """

    def __init__(
        self, actuators: Actuators, dt: float, generator: np.random.Generator, hold: int = 5, top: float = 39.0
    ) -> None:
        if not (actuators.longitudinal and actuators.lateral):
            raise ConfigError("random driving needs throttle and steering; these actuators lack one of them")
        if hold < 1 or not (dt > 0 and top > 0):
            raise ConfigError(f"hold must be at least 1, dt and top positive, got {hold}, {dt!r} and {top!r}")
        self._actuators, self._dt, self._generator, self._hold, self._top = actuators, dt, generator, hold, top
        self._left, self._action = 0, np.zeros(ACTION_DIM, np.float32)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """A random action (2,) float32; only the speed is read from the observation."""
        if self._left == 0 or (episode_start is not None and np.any(episode_start)):
            self._left = int(self._generator.integers(1, self._hold + 1))
            self._action = self._draw(observation)
        self._left -= 1
        return self._action, None

    def _draw(self, observation: Any) -> Any:
        """A random action (2,) that keeps the speed within its range while it is applied."""
        rng, (low, high), (left, right) = self._generator, self._actuators.acceleration, self._actuators.steering
        x = state(observation)
        speed, lasting = float(x[2] * x[4] + x[3] * x[5]), self._left * self._dt
        # The probability of braking makes the mean acceleration zero.
        brakes = rng.random() < high / (high - low)
        acceleration = rng.uniform(low, 0.0) if brakes else rng.uniform(0.0, high)
        acceleration = float(np.clip(acceleration, -max(speed, 0.0) / lasting, (self._top - speed) / lasting))
        size = 10.0 ** rng.uniform(-_FINE, 0.0)
        wheel = size * (right if rng.random() < 0.5 else left)
        return self._actuators.normalised(np.array([acceleration, wheel]))
