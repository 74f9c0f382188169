r"""highway-env's kinematic bicycle, batched in numpy and as CasADi expressions.

Notation
--------
State (x, y, psi, v), input (a, delta): acceleration [m/s^2], front wheel angle [rad]; L = 5 m is the
vehicle's length, as wheel base. With slip angle beta = atan(tan(delta) / 2), one explicit Euler step is

    x'   = x + v cos(psi + beta) dt          psi' = psi + v sin(beta) / (L/2) dt
    y'   = y + v sin(psi + beta) dt          v'   = v + a dt

Source: Polack et al. 2017, in the form of `Vehicle.step` of highway-env 1.12 (position first, with the
old heading and speed). Above `MAX_SPEED` the acceleration is limited to MAX_SPEED - v, below its negative
likewise (`Vehicle.clip_actions`).
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from dynamics.state import FloatArray, State

__all__ = ["LENGTH", "MAX_SPEED", "WIDTH", "StateExpressions", "slip_of", "slip_step", "step", "step_expression"]

StateExpressions = tuple[Any, Any, Any, Any]
"""A state as expressions (x, y, psi, v) or (s, r, psi, v): scalars, or columns with one row for each vehicle."""

LENGTH = 5.0
"""Vehicle length [m] (`Vehicle.LENGTH`)."""
WIDTH = 2.0
"""Vehicle width [m] (`Vehicle.WIDTH`)."""
MAX_SPEED = 40.0
"""Speed above which highway-env limits the acceleration [m/s] (`Vehicle.MAX_SPEED`)."""
_FREE = 1e15
"""Greater than any acceleration [m/s^2]."""


def step(states: FloatArray, acceleration: Any, steering: Any, dt: float) -> FloatArray:
    """One simulation frame.

    Parameters
    ----------
    states : (..., 4) in the order of `State`; world or road frame alike.
    acceleration, steering : broadcastable to (...); [m/s^2], [rad].
    dt : frame duration [s].

    Returns
    -------
    The next states (..., 4); the input is not changed.
    """
    psi, v = states[..., State.HEADING], states[..., State.SPEED]
    a = np.where(v > MAX_SPEED, np.minimum(acceleration, MAX_SPEED - v), acceleration)
    a = np.where(v < -MAX_SPEED, np.maximum(a, -MAX_SPEED - v), a)
    beta = np.arctan(0.5 * np.tan(steering))
    out = np.empty(np.broadcast_shapes(states.shape, (*np.shape(steering), 4)))
    out[..., State.X] = states[..., State.X] + v * np.cos(psi + beta) * dt
    out[..., State.Y] = states[..., State.Y] + v * np.sin(psi + beta) * dt
    out[..., State.HEADING] = psi + v * np.sin(beta) / (LENGTH / 2) * dt
    out[..., State.SPEED] = v + a * dt
    return out


def step_expression(state: ca.SX, acceleration: ca.SX, steering: ca.SX, dt: float) -> ca.SX:
    """The same step as a CasADi expression: state (4, 1) to next state (4, 1)."""
    after: Any = slip_step((state[0], state[1], state[2], state[3]), acceleration, slip_of(steering), dt)
    found: ca.SX = ca.vertcat(*after)
    return found


def slip_step(state: StateExpressions, acceleration: Any, slip: Any, dt: float) -> StateExpressions:
    """The same step in terms of the sine of the slip angle, element by element: scalars or columns of vehicles."""
    x, y, psi, v = state
    sin, cos, way = ca.sin(psi), ca.cos(psi), v * dt
    ahead = ca.sqrt(1 - slip * slip)
    a = ca.fmin(acceleration, MAX_SPEED - v + _FREE * (v <= MAX_SPEED))
    a = ca.fmax(a, -MAX_SPEED - v - _FREE * (v >= -MAX_SPEED))
    return (
        x + way * (cos * ahead - sin * slip),
        y + way * (sin * ahead + cos * slip),
        psi + way * slip * (2 / LENGTH),
        v + a * dt,
    )


def slip_of(steering: Any) -> Any:
    """Sine of the slip angle for a front wheel angle [rad], as a CasADi expression."""
    half = 0.5 * ca.tan(steering)
    return half / ca.sqrt(1 + half * half)
