"""Constant inputs for some frames, then a stop with constant steering, in closed form: no loop over frames.

Notation
--------
State (x, y, psi, v) and input (a, delta) of `dynamics.vehicle.bicycle`, beta the slip angle of delta, L the wheel base.
The input is constant for h frames of dt. Then the brake acts against the velocity, at b, decided once in p frames, T =
p dt:

    v_k = v_0 + k a dt  (k <= h)          |v| after j such periods: max(|v_h| - j b T, 0), linear within one

so that the vehicle comes to rest at the end of a period and never turns back. With constant steering, no quantity
depends on position or heading, and the explicit Euler frames of highway-env are sums:

    psi_k = psi_0 + sum_{i<k} v_i sin(beta) / (L/2) dt
    x_k   = x_0 + sum_{i<k} v_i cos(psi_i + beta) dt          y_k = y_0 + sum_{i<k} v_i sin(psi_i + beta) dt

They equal those of `dynamics.vehicle.bicycle.step` as long as |v| <= `MAX_SPEED`, beyond which highway-env limits the
acceleration.
"""

from __future__ import annotations

import numpy as np

from dynamics.state import FloatArray, State
from dynamics.vehicle.bicycle import LENGTH

__all__ = ["stops"]


def stops(
    state: FloatArray,
    inputs: FloatArray,
    hold: int,
    braking: float,
    dt: float,
    period: int = 1,
    length: float = LENGTH,
) -> FloatArray:
    """Each input for some frames, and then a stop.

    Parameters
    ----------
    state : in the world frame, columns `State`, (4,).
    inputs : acceleration [m/s^2] and front wheel angle [rad] of each candidate, (n, 2).
    hold : number of frames with the input.
    braking : deceleration of the stop [m/s^2].
    dt : duration of a frame [s].
    period : number of frames with the same deceleration during the stop.
    length : of the vehicle, as wheel base [m].

    Returns
    -------
    States after each frame, (n, hold + frames of the longest stop, 4); in the last ones the vehicle stands.

    Examples
    --------
    >>> path = stops(np.array([0.0, 0.0, 0.0, 1.0]), np.zeros((1, 2)), 1, 5.0, 0.1)
    >>> path[0, :, State.SPEED].tolist(), path[0, :, State.X].round(3).tolist()
    ([1.0, 0.5, 0.0], [0.1, 0.2, 0.25])
    """
    a, delta = inputs[:, :1], inputs[:, 1:]
    held = state[State.SPEED] + a * dt * np.arange(hold + 1)
    top, less = np.abs(held[:, -1:]), braking * period * dt
    periods = int(np.ceil(float(top.max()) / less))
    after = np.maximum(top - less * np.arange(periods + 1), 0.0)
    share = np.arange(1, period + 1) / period
    # In this form the end of a period equals the start of the next exactly, and the speed at a stop is exactly 0.
    slower = after[:, :-1, None] * (1 - share) + after[:, 1:, None] * share
    speeds = np.hstack([held, np.copysign(slower.reshape(len(inputs), -1), held[:, -1:])])
    way, beta = speeds[:, :-1] * dt, np.arctan(0.5 * np.tan(delta))
    heading = state[State.HEADING] + np.cumsum(way * np.sin(beta) / (length / 2), axis=1)
    before = np.hstack([np.full_like(beta, state[State.HEADING]), heading[:, :-1]]) + beta
    out = np.empty((*way.shape, 4))
    out[..., State.X] = state[State.X] + np.cumsum(way * np.cos(before), axis=1)
    out[..., State.Y] = state[State.Y] + np.cumsum(way * np.sin(before), axis=1)
    out[..., State.HEADING], out[..., State.SPEED] = heading, speeds[:, 1:]
    return out
