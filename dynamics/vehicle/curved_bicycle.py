"""highway-env's bicycle and lane keeping in the frame of a curved road; `dynamics.vehicle.rollout_kernels` has the
loops.

Notation
--------
Road state (s, r, psi, v), curvature k [1/m] at s. An Euler step moves the vehicle along a straight line, (dx, dy) = v
dt (cos(psi + beta), sin(psi + beta)) in the frame of the path at s. On one arc, with Y = r + dy and D = 1 - k Y, that
is exactly

    s'   = s + atan2(k dx, D) / k
    r'   = (2 Y - k (Y^2 + dx^2)) / (1 + sqrt(D^2 + k^2 dx^2))
    psi' = psi + v sin(beta) / (L/2) dt - k (s' - s)

A step that ends beyond a joint of the path is projected again, on the arc behind the joint, and so on; this is exact
too.

Source: geometry (`dynamics.roads.arcs`) and `dynamics.vehicle.bicycle`. The control is that of
`dynamics.vehicle.controllers` with the slip angle for a bend of radius 1/kappa: sin(beta) = kappa L / 2 with kappa = k
/ (1 - k r), at psi = kappa v dt / 2 - beta. (An Euler step follows a chord of the bend, which points inwards by half of
the angle that it spans.)
"""

from __future__ import annotations

import math
from typing import Any

from dynamics.state import FloatArray
from dynamics.vehicle.controllers import steering_control
from dynamics.vehicle.rollout_kernels import slip_at, table_of

__all__ = ["steer"]


def steer(road: Any, state: FloatArray, r: float, dt: float) -> float:
    """Front wheel angle [rad] that steers a road state (4,) to lateral position `r` [m] on any road."""
    if road.bends is None:
        return float(steering_control(state, r))
    s, across, psi, v = (float(x) for x in state)
    return math.atan(2 * math.tan(math.asin(slip_at(s, across, psi, v, float(r), table_of(road), dt))))
