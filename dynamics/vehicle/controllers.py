"""highway-env's low-level control, batched: acceleration and steering that track a target command.

Notation
--------
Road frame (s, r, psi, v). A *target* is (r*, v*): the lateral position of the target lane's centre [m] and the target
speed [m/s]. Gains are those of `ControlledVehicle` in highway-env 1.12; on a straight road its pursuit point has the
heading of the road, which is 0 in the road frame.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.state import FloatArray, RoadState, wrap_to_pi
from dynamics.vehicle.bicycle import LENGTH

__all__ = [
    "KP_HEADING",
    "KP_LATERAL",
    "KP_SPEED",
    "MAX_SLIP",
    "MAX_STEERING",
    "speed_control",
    "speed_to_index",
    "steering_control",
]

KP_SPEED = 1 / 0.6
"""Speed gain [1/s] (`ControlledVehicle.KP_A`)."""
KP_LATERAL = 1 / 0.6
"""Lateral position gain [1/s] (`ControlledVehicle.KP_LATERAL`)."""
KP_HEADING = 1 / 0.2
"""Heading gain [1/s] (`ControlledVehicle.KP_HEADING`)."""
MAX_STEERING = np.pi / 3
"""Limit of the wheel angle [rad] (`ControlledVehicle.MAX_STEERING_ANGLE`)."""
MAX_SLIP = float(np.sin(np.arctan(0.5 * np.tan(MAX_STEERING))))
"""Sine of the slip angle at that limit."""
_NONZERO = 1e-2


def _not_zero(x: FloatArray) -> FloatArray:
    return np.where(np.abs(x) > _NONZERO, x, np.where(x >= 0, _NONZERO, -_NONZERO))


def speed_control(speed: Any, target_speed: Any) -> Any:
    """Acceleration [m/s^2] of the proportional speed controller (not clipped, as in highway-env)."""
    return KP_SPEED * (np.asarray(target_speed) - speed)


def steering_control(states: FloatArray, target_r: Any) -> FloatArray:
    """Wheel angle [rad] that steers road states (..., 4) to lateral position `target_r` [m].

    Source: `ControlledVehicle.steering_control` of highway-env 1.12.
    """
    r, psi, v = (states[..., i] for i in (RoadState.R, RoadState.HEADING, RoadState.SPEED))
    v = _not_zero(v)
    heading_command = np.arcsin(np.clip(-KP_LATERAL * (r - target_r) / v, -1, 1))
    heading_ref = np.clip(heading_command, -np.pi / 4, np.pi / 4)
    heading_rate = KP_HEADING * wrap_to_pi(heading_ref - psi)
    slip = np.arcsin(np.clip(LENGTH / 2 / v * heading_rate, -1, 1))
    found: FloatArray = np.clip(np.arctan(2 * np.tan(slip)), -MAX_STEERING, MAX_STEERING)
    return found


def speed_to_index(speed: float, target_speeds: tuple[float, ...]) -> int:
    """Index of the allowed target speed nearest to `speed` [m/s].

    Source: `MDPVehicle.speed_to_index` of highway-env 1.12 (a uniform list is assumed there too).
    """
    last = len(target_speeds) - 1
    x = (speed - target_speeds[0]) / (target_speeds[-1] - target_speeds[0])
    return int(min(max(np.round(x * last), 0), last))
