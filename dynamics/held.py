"""Rollouts of a brake whose inputs are held for a whole decision period: the fail-safe of an agent with actions only.

Notation
--------
A *stop* per candidate is (r*, b, delta_max): the lateral position to steer to [m], the deceleration [m/s^2] and the
greatest wheel angle [rad]. At the start of each period of h frames the inputs are

    a     = -min(b, max(v, 0) / (h dt))
    delta = clip(steering_control(x, r*), -delta_max, delta_max)

so that the ego brakes at b and comes to rest at the end of a period. On a curved road the steering knows the curvature
there (`dynamics.curved`). Source of the steering law: `ControlledVehicle.steering_control` of highway-env 1.12, sampled
once in a period.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi as ca

from dynamics.bicycle import slip_of, slip_step
from dynamics.controllers import slip_expression
from dynamics.curved import curved_slip, curved_step, lookup
from dynamics.path import CurvatureProfile, PathRoad
from dynamics.road import StraightRoad
from dynamics.rollout import MANY, Bound, padded_rows
from dynamics.state import FloatArray

__all__ = ["HeldRollouts", "period_function"]

_PERIODS = 4


def period_function(rows: int, dt: float, hold: int, profile: CurvatureProfile | None = None) -> ca.Function:
    """One decision period: states (rows, 4), stops (rows, 3) -> states after it (rows, 4), after each frame
    (rows, 4 hold); a single one is (4, 1), (3, 1) -> (4, 1), (4, hold)."""
    one = rows == 1
    symbol: Any = ca.SX.sym if one and profile is None else ca.MX.sym
    x, c = (symbol(name, n, 1) if one else symbol(name, rows, n) for name, n in (("x", 4), ("c", 3)))
    state: Any = tuple(x[i] if one else x[:, i] for i in range(4))
    goal, braking, most = (c[i] if one else c[:, i] for i in range(3))
    a = -ca.fmin(braking, ca.fmax(state[3], 0) / (hold * dt))
    row = None if profile is None else lookup(profile, state[0])
    slip = slip_expression(state, goal) if row is None else curved_slip(state, goal, row[1], dt)
    limit = slip_of(most)
    slip = ca.fmin(ca.fmax(slip, -limit), limit)
    states: list[Any] = []
    for _ in range(hold):
        if profile is None:
            state = slip_step(state, a, slip, dt)
        else:
            state = curved_step(state, a, slip, lookup(profile, state[0]), dt)
        states.append(ca.vertcat(*state) if one else ca.horzcat(*state))
    return ca.Function("period", [x, c], [states[-1], ca.horzcat(*states)], {"cse": True})


@lru_cache(maxsize=128)
def _compiled(rows: int, periods: int, dt: float, hold: int, profile: CurvatureProfile | None) -> ca.Function:
    if rows < MANY:
        return period_function(1, dt, hold, profile).mapaccum(periods).map(rows)
    return period_function(rows, dt, hold, profile).mapaccum(periods)


class HeldRollouts:
    """Owns the buffers of the compiled rollouts for one frame duration and decision period on one road.

    Parameters
    ----------
    dt : frame duration [s].
    hold : frames for which inputs are held.
    road : the road; its road frame is that of the states. Every straight road has the same rollouts.
    """

    def __init__(self, dt: float, hold: int, road: StraightRoad | PathRoad | None = None) -> None:
        self.dt, self.hold = dt, hold
        self._profile = road.profile if isinstance(road, PathRoad) else None
        self._slots: dict[tuple[int, int], Bound] = {}

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
        rows, padded = padded_rows(n), -(-periods // _PERIODS) * _PERIODS
        key = (rows, padded)
        if key not in self._slots:
            function = _compiled(rows, padded, self.dt, self.hold, self._profile)
            self._slots[key] = Bound(function, rows, padded, 3, padded * self.hold)
        bound = self._slots[key]
        bound.start[:n], bound.controls[:n] = states, stops[:, None]
        bound()
        return bound.paths[:n, : periods * self.hold].copy()
