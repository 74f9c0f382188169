"""Lane choice, steering and acceleration of all bodies in a frame: highway-env's `Road.act`."""

from __future__ import annotations

import math

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.arithmetic import clip, dot2, not_zero, wrap_to_pi
from dynamics.highway_simulator.arrays import Bodies, LaneNeighbours, Machine
from dynamics.highway_simulator.layout import (
    ACC_MAX,
    ACCELERATION,
    CHANGES,
    COMFORT,
    CONTINUOUS,
    CRASHED,
    DELTA,
    EGO,
    HEADING,
    IDM,
    KIND,
    LANE,
    LANE_Y,
    LENGTH,
    LINEAR,
    S_HEADING,
    S_LATERAL,
    SPEED,
    STEERING,
    TARGET,
    TARGET_SPEED,
    Y,
)
from dynamics.highway_simulator.loops import apply, apply_two, c_pow
from dynamics.highway_simulator.traffic import acceleration, change_lanes, free_flow, target_speed_ratio
from dynamics.state import FloatArray, IntArray

__all__ = ["KP_A", "KP_LATERAL", "act", "free_flow_of_all", "linear_wheel", "pursue"]

KP_A, _KP_HEADING, KP_LATERAL = 1 / 0.6, 1 / 0.2, 1 / 0.6
_WHEEL, _TURN = math.pi / 3, math.pi / 4
"""Greatest steering angle, and greatest commanded heading relative to the lane [rad]."""
_TAN, _ARCTAN, _ARCSIN, _POWER, _C_POW = 0, 1, 2, 5, 6


@kernel_no_refcount
def free_flow_of_all(
    loops: IntArray, f: FloatArray, g: IntArray, p: FloatArray, lanes: FloatArray, work: FloatArray, vehicles: int
) -> None:
    """IDM's acceleration of each vehicle on an empty road [m/s^2], written to the first row of `work` (4, m)."""
    free, share, delta, power = work[0], work[1], work[2], work[3]
    for i in range(vehicles):
        share[i] = target_speed_ratio(f, g, lanes, i) if g[KIND, i] == IDM else 1.0
        delta[i] = p[DELTA, i]
    apply_two(loops[_POWER, 0], loops[_POWER, 1], share, delta, power, vehicles)
    for i in range(vehicles):
        # With a scalar exponent of 2, numpy computes a product.
        free[i] = free_flow(p[COMFORT, i], share[i] * share[i] if delta[i] == 2.0 else power[i])


@kernel_no_refcount
def pursue(
    loops: IntArray,
    f: FloatArray,
    p: FloatArray,
    ahead: FloatArray,
    x: FloatArray,
    y: FloatArray,
    busy: IntArray,
    n: int,
) -> None:
    """highway-env's `steering_control` from the heading command on: the front wheel angle of the first n bodies in
    `busy` [rad].

    Parameters
    ----------
    ahead : heading of each body's target lane ahead of it [rad].
    x : commanded lateral speed divided by the speed, overwritten. y : buffer, written.
    """
    if n == 0:
        return
    apply(loops[_ARCSIN, 0], loops[_ARCSIN, 1], x, y, n)
    for k in range(n):
        i = busy[k]
        rate = _KP_HEADING * wrap_to_pi(ahead[k] + clip(y[k], -_TURN, _TURN) - f[HEADING, i])
        x[k] = clip(p[LENGTH, i] / 2 / not_zero(f[SPEED, i]) * rate, -1.0, 1.0)
    apply(loops[_ARCSIN, 0], loops[_ARCSIN, 1], x, y, n)
    apply(loops[_TAN, 0], loops[_TAN, 1], y, x, n)
    for k in range(n):
        x[k] = 2 * x[k]
    apply(loops[_ARCTAN, 0], loops[_ARCTAN, 1], x, y, n)
    for k in range(n):
        f[STEERING, busy[k]] = clip(y[k], -_WHEEL, _WHEEL)


@kernel_inline
def linear_wheel(
    sums: int, loops: IntArray, f: FloatArray, p: FloatArray, i: int, ahead: float, lateral: float
) -> float:
    """Front wheel angle of a vehicle of the linear model [rad].

    Parameters
    ----------
    ahead : heading of its target lane ahead of it [rad]. lateral : its distance from the centre of that lane [m].
    """
    speed = not_zero(f[SPEED, i])
    turn = wrap_to_pi(ahead - f[HEADING, i]) * p[LENGTH, i] / speed
    back = -lateral * p[LENGTH, i] / c_pow(loops[_C_POW, 0], speed, 2.0)
    return clip(dot2(sums, p[S_HEADING, i], turn, p[S_LATERAL, i], back), -_WHEEL, _WHEEL)


@kernel_no_refcount
def _steer(machine: Machine, bodies: Bodies, work: FloatArray, busy: IntArray, vehicles: int) -> None:
    """Steering of each vehicle towards the centre of its target lane [rad]."""
    f, g, p, lanes, loops = bodies.f, bodies.g, bodies.p, bodies.lanes, machine.loops
    ahead, x, n = work[0], work[1], 0
    for i in range(vehicles):
        kind, lateral = g[KIND, i], f[Y, i] - lanes[g[TARGET, i], LANE_Y]
        if kind == EGO or (kind == IDM and not g[CRASHED, i]):
            if lateral == 0.0 and f[HEADING, i] == 0.0:
                f[STEERING, i] = 0.0
                continue
            ahead[n], x[n] = 0.0, clip(-KP_LATERAL * lateral / not_zero(f[SPEED, i]), -1.0, 1.0)
            busy[n] = i
            n += 1
        elif kind == LINEAR and not g[CRASHED, i]:
            f[STEERING, i] = linear_wheel(machine.sums, loops, f, p, i, 0.0, lateral)
    pursue(loops, f, p, ahead, x, work[2], busy, n)


@kernel_no_refcount
def act(
    machine: Machine, bodies: Bodies, near: LaneNeighbours, work: FloatArray, busy: IntArray, vehicles: int
) -> None:
    """Target lanes of all vehicles, one after the other; then steering and acceleration.

    Parameters
    ----------
    work, busy : buffers, (4, m) and (m,), written.
    """
    free, present = work[0], work[1]
    f, g, p, front = bodies.f, bodies.g, bodies.p, near.front
    free_flow_of_all(machine.loops, f, g, p, bodies.lanes, work, vehicles)
    changing = 0
    for i in range(vehicles):
        if g[KIND, i] in (IDM, LINEAR) and not g[CRASHED, i]:
            leader = front[g[LANE, i], i]
            present[i] = acceleration(machine, bodies, i, i, leader, free[i])
        if g[LANE, i] != g[TARGET, i] and g[KIND, i] != CONTINUOUS:
            busy[changing] = i
            changing += 1
    for i in range(vehicles):
        if g[KIND, i] in (IDM, LINEAR) and not g[CRASHED, i] and g[CHANGES, i]:
            changing = change_lanes(machine, bodies, near, i, busy, changing, (free[i], present[i]))
    for i in range(vehicles):
        kind = g[KIND, i]
        if kind == EGO:
            f[ACCELERATION, i] = KP_A * (f[TARGET_SPEED, i] - f[SPEED, i])
        elif kind in (IDM, LINEAR) and not g[CRASHED, i]:
            wanted, target = present[i], g[TARGET, i]
            if g[LANE, i] != target:
                leader = front[target, i]
                wanted = min(wanted, acceleration(machine, bodies, i, i, leader, free[i]))
            f[ACCELERATION, i] = clip(wanted, -p[ACC_MAX, i], p[ACC_MAX, i])
    _steer(machine, bodies, work, busy, vehicles)
