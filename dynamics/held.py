"""Rollouts of a brake whose inputs are held for a whole decision period: the fail-safe of an agent with actions only.

Notation
--------
A *stop* per candidate is (r*, b, delta_max): the lateral position to steer to [m], the deceleration [m/s^2] and the
greatest wheel angle [rad]. At the start of each period of h frames the inputs are

    a     = -min(b, max(v, 0) / (h dt))
    delta = clip(steering_control(x, r*), -delta_max, delta_max)

so that the ego brakes at b and comes to rest at the end of a period. Source of the steering law:
`ControlledVehicle.steering_control` of highway-env 1.12, sampled once in a period.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from dynamics.bicycle import step_expression
from dynamics.controllers import steering_expression
from dynamics.state import FloatArray

__all__ = ["HeldRollouts", "period_function"]

_ROWS = (1, 2, 4, 8, 16, 32, 48, 64, 96, 128, 256, 512)
_PERIODS = 4


def period_function(dt: float, hold: int) -> ca.Function:
    """One decision period: state (4), stop (3) -> state after it (4), states after each frame (4, hold)."""
    x, c = ca.SX.sym("x", 4), ca.SX.sym("c", 3)
    a = -ca.fmin(c[1], ca.fmax(x[3], 0) / (hold * dt))
    delta = ca.fmin(ca.fmax(steering_expression(x, c[0]), -c[2]), c[2])
    states = []
    now = x
    for _ in range(hold):
        now = step_expression(now, a, delta, dt)
        states.append(now)
    return ca.Function("period", [x, c], [now, ca.horzcat(*states)])


@lru_cache(maxsize=128)
def _compiled(rows: int, periods: int, dt: float, hold: int) -> ca.Function:
    return period_function(dt, hold).mapaccum(periods).map(rows)


class HeldRollouts:
    """Owns the buffers of the compiled rollouts for one frame duration and decision period on straight roads.

    Parameters
    ----------
    dt : frame duration [s].
    hold : frames for which inputs are held.
    """

    def __init__(self, dt: float, hold: int) -> None:
        self.dt, self.hold = dt, hold
        self._slots: dict[tuple[int, int], tuple[FloatArray, FloatArray, FloatArray, FloatArray, object]] = {}

    def run(self, states: FloatArray, stops: FloatArray, periods: int) -> FloatArray:
        """Brake from each state.

        Parameters
        ----------
        states : road states, (n, 4). stops : (n, 3). periods : how many decision periods.

        Returns
        -------
        Road states after each frame, (n, periods * hold, 4).
        """
        n = len(states)
        rows = next((r for r in _ROWS if r >= n), n)
        padded = -(-periods // _PERIODS) * _PERIODS
        key = (rows, padded)
        if key not in self._slots:
            x0, c = np.zeros((rows, 4)), np.zeros((rows, padded, 3))
            last, out = np.zeros((rows, padded, 4)), np.zeros((rows, padded * self.hold, 4))
            buffer, call = _compiled(rows, padded, self.dt, self.hold).buffer()
            buffer.set_arg(0, memoryview(x0))  # type: ignore[call-arg, arg-type]
            buffer.set_arg(1, memoryview(c))  # type: ignore[call-arg, arg-type]
            buffer.set_res(0, memoryview(last))  # type: ignore[call-arg, arg-type]
            buffer.set_res(1, memoryview(out))  # type: ignore[call-arg, arg-type]
            self._slots[key] = (x0, c, last, out, (buffer, call))
        x0, c, _, out, (_, call) = self._slots[key]  # type: ignore[misc]
        x0[:n], c[:n] = states, stops[:, None]
        call()
        return out[:n, : periods * self.hold].copy()
