"""Motion of bodies in a frame: highway-env's modified bicycle model, and their lanes afterwards."""

from __future__ import annotations

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.arrays import Bodies
from dynamics.highway_simulator.lanes import closest_lane, lanes_at
from dynamics.highway_simulator.layout import (
    ACCELERATION,
    COS,
    CRASHED,
    HEADING,
    IDM,
    IMPACT_X,
    IMPACT_Y,
    IMPACTED,
    KIND,
    LANE,
    LANE_LENGTH,
    LENGTH,
    LINEAR,
    MAX_SPEED,
    MIN_SPEED,
    ON,
    SIN,
    SPEED,
    STALE,
    STEERING,
    TIMER,
    X,
    Y,
)
from dynamics.highway_simulator.loops import apply
from dynamics.state import FloatArray, IntArray

__all__ = ["bicycle", "limit", "move"]

_TAN, _ARCTAN, _COS, _SIN = 0, 1, 3, 4


@kernel_inline
def limit(f: FloatArray, g: IntArray, p: FloatArray, i: int, dt: float) -> None:
    """highway-env's `clip_actions` of a vehicle; its timer advances by a frame."""
    speed = f[SPEED, i]
    if g[KIND, i] in (IDM, LINEAR):
        f[TIMER, i] += dt
    if g[CRASHED, i]:
        f[STEERING, i], f[ACCELERATION, i] = 0.0, -1.0 * speed
    if speed > p[MAX_SPEED, i]:
        f[ACCELERATION, i] = min(f[ACCELERATION, i], 1.0 * (p[MAX_SPEED, i] - speed))
    elif speed < p[MIN_SPEED, i]:
        f[ACCELERATION, i] = max(f[ACCELERATION, i], 1.0 * (p[MIN_SPEED, i] - speed))


@kernel_no_refcount
def bicycle(
    loops: IntArray,
    f: FloatArray,
    g: IntArray,
    p: FloatArray,
    work: FloatArray,
    busy: IntArray,
    n: int,
    dt: float,
) -> None:
    """Advance the first n bodies in `busy` by a frame of `dt` [s], and apply the impacts of the last frame.

    Parameters
    ----------
    work : buffer, (4, m), written.
    """
    slip, course, across, along = work[0], work[1], work[2], work[3]
    for k in range(n):
        across[k] = f[STEERING, busy[k]]
    apply(loops[_TAN, 0], loops[_TAN, 1], across, along, n)
    for k in range(n):
        along[k] = 0.5 * along[k]
    apply(loops[_ARCTAN, 0], loops[_ARCTAN, 1], along, slip, n)
    for k in range(n):
        course[k] = f[HEADING, busy[k]] + slip[k]
    apply(loops[_COS, 0], loops[_COS, 1], course, along, n)
    apply(loops[_SIN, 0], loops[_SIN, 1], course, across, n)
    apply(loops[_SIN, 0], loops[_SIN, 1], slip, course, n)
    for k in range(n):
        i = busy[k]
        speed = f[SPEED, i]
        f[X, i] += speed * along[k] * dt
        f[Y, i] += speed * across[k] * dt
        if g[IMPACTED, i]:
            f[X, i] += f[IMPACT_X, i]
            f[Y, i] += f[IMPACT_Y, i]
            g[CRASHED, i], g[IMPACTED, i] = 1, 0
        f[HEADING, i] += speed * course[k] / (p[LENGTH, i] / 2) * dt
        f[SPEED, i] += f[ACCELERATION, i] * dt
        slip[k] = f[HEADING, i]
    apply(loops[_COS, 0], loops[_COS, 1], slip, along, n)
    apply(loops[_SIN, 0], loops[_SIN, 1], slip, across, n)
    for k in range(n):
        f[COS, busy[k]], f[SIN, busy[k]] = along[k], across[k]


@kernel_no_refcount
def move(loops: IntArray, bodies: Bodies, work: FloatArray, busy: IntArray, vehicles: int, dt: float) -> None:
    """Advance all vehicles by a frame of `dt` [s], and apply the impacts of the last frame.

    Parameters
    ----------
    work, busy : buffers, (4, m) and (m,), written.
    """
    f, g, p, lanes = bodies.f, bodies.g, bodies.p, bodies.lanes
    n = 0
    for i in range(vehicles):
        limit(f, g, p, i, dt)
        if f[STEERING, i] == 0.0 and f[HEADING, i] == 0.0 and not g[IMPACTED, i] and not g[STALE, i]:
            before = f[X, i]
            f[X, i] += f[SPEED, i] * dt
            f[SPEED, i] += f[ACCELERATION, i] * dt
            if not (0.0 <= before < lanes[0, LANE_LENGTH] and 0.0 <= f[X, i] < lanes[0, LANE_LENGTH]):
                g[ON, i] = lanes_at(lanes, f[X, i], f[Y, i])
        else:
            busy[n] = i
            n += 1
    if n > 0:
        bicycle(loops, f, g, p, work, busy, n, dt)
    for k in range(n):
        i = busy[k]
        g[LANE, i], g[STALE, i] = closest_lane(lanes, f[X, i], f[Y, i], f[HEADING, i]), 0
        g[ON, i] = lanes_at(lanes, f[X, i], f[Y, i])
