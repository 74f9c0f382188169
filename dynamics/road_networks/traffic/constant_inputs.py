"""Motion of an ego with constant throttle and steering, on either of highway-env's bicycle models."""

from __future__ import annotations

import math

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.arithmetic import clip, dot2
from dynamics.highway_simulator.layout import (
    ACCELERATION,
    COS,
    CRASHED,
    HEADING,
    IMPACTED,
    SIN,
    SPEED,
    STEERING,
    X,
    Y,
)
from dynamics.highway_simulator.loops import at, at_two
from dynamics.highway_simulator.motion import bicycle, limit
from dynamics.road_networks.geometry.layout import DYNAMICAL, LATERAL_SPEED, YAW_RATE
from dynamics.road_networks.geometry.routes import NetworkTraffic
from dynamics.state import FloatArray, IntArray

__all__ = ["predict_with_constant_inputs", "slipping_bicycle"]

_COS, _SIN, _ARCTAN2 = 3, 4, 7
_HALF, _INERTIA, _FRICTION = 2.5, 1 / 12 * 1 * (5.0**2 + 2.0**2), 15.0
"""`BicycleVehicle.LENGTH_A` [m], `INERTIA_Z` [kg m^2] and `FRICTION_FRONT` [N] of 1 kg."""
_FASTEST_TURN = 2 * math.pi
"""`BicycleVehicle.MAX_ANGULAR_SPEED` [rad/s]."""


@kernel_inline
def _rates(
    loops: IntArray, products: int, steering: float, heading: float, speed: float, lateral: float, yaw: float
) -> tuple[float, float, float, float]:
    """`BicycleVehicle.derivative_func`: of x, y, the lateral speed and the yaw rate."""
    f, r = lateral + _HALF * yaw, lateral - _HALF * yaw
    front = 2 * _FRICTION * (steering - at_two(loops[_ARCTAN2, 0], loops[_ARCTAN2, 1], f, speed))
    rear = 2 * _FRICTION * (0 - at_two(loops[_ARCTAN2, 0], loops[_ARCTAN2, 1], r, speed))
    if abs(speed) < 1:
        front = -1 * lateral - _INERTIA / _HALF * yaw
        rear = -1 * lateral + _INERTIA / _HALF * yaw
    sideways = 1 / 1 * (front + rear) - yaw * speed
    turning = 1 / _INERTIA * (_HALF * front - _HALF * rear)
    c, s = at(loops[_COS, 0], loops[_COS, 1], heading), at(loops[_SIN, 0], loops[_SIN, 1], heading)
    dx, dy = dot2(products, -s, lateral, c, speed), dot2(products, c, lateral, s, speed)
    return dx, dy, sideways, turning


@kernel_inline
def _sum(dt: float, a: float, b: float, c: float, d: float) -> float:
    """Increment of a state in a fourth-order Runge-Kutta step."""
    return (dt / 6) * (a + (2 * b) + (2 * c) + d)


@kernel_no_refcount
def slipping_bicycle(loops: IntArray, products: int, f: FloatArray, i: int, dt: float) -> None:
    """A frame of `BicycleVehicle`, a bicycle with tyre slip, by highway-env's own fourth-order Runge-Kutta step."""
    f[STEERING, i] = clip(f[STEERING, i], -math.pi / 2, math.pi / 2)
    f[YAW_RATE, i] = clip(f[YAW_RATE, i], -_FASTEST_TURN, _FASTEST_TURN)
    wheel, a = f[STEERING, i], f[ACCELERATION, i]
    h, v, u, w, half = f[HEADING, i], f[SPEED, i], f[LATERAL_SPEED, i], f[YAW_RATE, i], dt / 2
    x1, y1, u1, w1 = _rates(loops, products, wheel, h, v, u, w)
    h2, v2, u2, w2 = h + w * half, v + a * half, u + u1 * half, w + w1 * half
    x2, y2, du2, dw2 = _rates(loops, products, wheel, h2, v2, u2, w2)
    h3, v3, u3, w3 = h + w2 * half, v + a * half, u + du2 * half, w + dw2 * half
    x3, y3, du3, dw3 = _rates(loops, products, wheel, h3, v3, u3, w3)
    h4, v4, u4, w4 = h + w3 * dt, v + a * dt, u + du3 * dt, w + dw3 * dt
    x4, y4, du4, dw4 = _rates(loops, products, wheel, h4, v4, u4, w4)
    f[X, i] += _sum(dt, x1, x2, x3, x4)
    f[Y, i] += _sum(dt, y1, y2, y3, y4)
    f[HEADING, i] += _sum(dt, w, w2, w3, w4)
    f[SPEED, i] += _sum(dt, a, a, a, a)
    f[LATERAL_SPEED, i] += _sum(dt, u1, du2, du3, du4)
    f[YAW_RATE, i] += _sum(dt, w1, dw2, dw3, dw4)
    f[COS, i] = at(loops[_COS, 0], loops[_COS, 1], f[HEADING, i])
    f[SIN, i] = at(loops[_SIN, 0], loops[_SIN, 1], f[HEADING, i])


@kernel_no_refcount
def predict_with_constant_inputs(
    traffic: NetworkTraffic,
    products: int,
    work: FloatArray,
    busy: IntArray,
    i: int,
    step: float,
    path: FloatArray,
) -> None:
    """The positions that highway-env predicts for the ego: constant steering, zero throttle. The state is left
    unchanged.

    Parameters
    ----------
    work, busy : buffers, (4, m) and (m,), written. step : time between two instants [s].
    path : (instants, 6), written: x, y [m], heading [rad], its cosine and sine, and 1 as these two are known.
    """
    f, g, p, loops = traffic.f, traffic.g, traffic.p, traffic.lanes.loops
    x, y, heading, speed, c, s = f[X, i], f[Y, i], f[HEADING, i], f[SPEED, i], f[COS, i], f[SIN, i]
    wheel, throttle, u, w = f[STEERING, i], f[ACCELERATION, i], f[LATERAL_SPEED, i], f[YAW_RATE, i]
    crashed, impacted = g[CRASHED, i], g[IMPACTED, i]
    busy[0] = i
    f[ACCELERATION, i] = 0.0
    for n in range(path.shape[0]):
        limit(f, g, p, i, step)
        if g[DYNAMICAL, i]:
            slipping_bicycle(loops, products, f, i, step)
        else:
            bicycle(loops, f, g, p, work, busy, 1, step)
        path[n, 0], path[n, 1], path[n, 2] = f[X, i], f[Y, i], f[HEADING, i]
        path[n, 3], path[n, 4], path[n, 5] = f[COS, i], f[SIN, i], 1.0
    f[X, i], f[Y, i], f[HEADING, i], f[SPEED, i], f[COS, i], f[SIN, i] = x, y, heading, speed, c, s
    f[STEERING, i], f[ACCELERATION, i], f[LATERAL_SPEED, i], f[YAW_RATE, i] = wheel, throttle, u, w
    g[CRASHED, i], g[IMPACTED, i] = crashed, impacted
