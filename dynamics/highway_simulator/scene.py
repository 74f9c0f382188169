"""Initial scene: highway-env's `_create_vehicles`, in the same order of random draws."""

from __future__ import annotations

import math

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.arrays import Bodies, Rules
from dynamics.highway_simulator.lanes import closest_lane, lanes_at
from dynamics.highway_simulator.layout import (
    A_SPEED,
    CHANGES,
    CHECKS,
    COS,
    CRASHED,
    DELAY,
    DELTA,
    EGO,
    KIND,
    LANE,
    LANE_LIMIT,
    LANE_Y,
    LINEAR,
    ON,
    S_HEADING,
    SPEED,
    TARGET,
    TARGET_SPEED,
    TIMER,
    P,
    X,
    Y,
)
from dynamics.highway_simulator.random import GeneratorRow, below, uniform
from dynamics.state import FloatArray

__all__ = ["next_target_speed", "randomize", "spawn", "speed_index"]

_EGO_SPEED = 25.0


@kernel_inline
def _rint(x: float) -> float:
    """A number rounded half to even."""
    whole = math.floor(x)
    rest = x - whole
    if rest < 0.5 or (rest == 0.5 and whole % 2 == 0):
        return whole
    return whole + 1.0


@kernel_no_refcount
def speed_index(target_speeds: FloatArray, speed: float) -> int:
    """Index of the nearest target speed; they are equally spaced."""
    n = len(target_speeds)
    x = (speed - target_speeds[0]) / (target_speeds[n - 1] - target_speeds[0])
    return int(min(max(_rint(x * (n - 1)), 0.0), n - 1.0))


@kernel_no_refcount
def next_target_speed(target_speeds: FloatArray, speed: float, label: int) -> float:
    """The target speed after FASTER (3) or SLOWER (4) at a speed [m/s]."""
    index = speed_index(target_speeds, speed) + (1 if label == 3 else -1)
    return target_speeds[min(max(index, 0), len(target_speeds) - 1)]


@kernel_no_refcount
def randomize(row: GeneratorRow, kind: int, ranges: FloatArray, p: FloatArray, i: int) -> None:
    """Draw the parameters of a vehicle: highway-env's `randomize_behavior`.

    Parameters
    ----------
    row : the random generator.
    kind : `IDM` or `LINEAR`. ranges : (6, 2), see `dynamics.highway_simulator.kinds.ranges_of`.
    """
    if kind == LINEAR:
        for k in range(3):
            share = uniform(row, 0.0, 1.0)
            p[A_SPEED + k, i] = ranges[1 + k, 0] + share * (ranges[1 + k, 1] - ranges[1 + k, 0])
        for k in range(2):
            share = uniform(row, 0.0, 1.0)
            p[S_HEADING + k, i] = ranges[4 + k, 0] + share * (ranges[4 + k, 1] - ranges[4 + k, 0])
    p[DELTA, i] = uniform(row, ranges[0, 0], ranges[0, 1])


@kernel_no_refcount
def spawn(row: GeneratorRow, bodies: Bodies, rules: Rules) -> None:
    """Place the ego and the traffic on the road.

    Parameters
    ----------
    row : the random generator.
    """
    f, g, p, lanes, numbers = bodies.f, bodies.g, bodies.p, bodies.lanes, rules.numbers
    vehicles, first_lane, checks, kinds = numbers[1], numbers[2], numbers[3] != 0, (numbers[4], numbers[5])
    constants, spacings, target_speeds = rules.constants, rules.spacings, rules.target_speeds
    f[:], g[:] = 0.0, 0
    n = len(lanes)
    for i in range(vehicles):
        which = 0 if i == 0 else 1
        lane = first_lane if i == 0 and first_lane >= 0 else below(row, n)
        limit = lanes[lane, LANE_LIMIT]
        speed = _EGO_SPEED if i == 0 else uniform(row, 0.7 * limit, 0.8 * limit)
        offset = spacings[which] * (12 + 1.0 * speed) * spacings[2]
        x = 3 * offset
        if i > 0:
            x = f[X, 0]
            for j in range(1, i):
                x = max(x, f[X, j])
        x += offset * uniform(row, 0.9, 1.1)
        turn = 0 if i == 0 else 1 + (i - 1) % (constants.shape[0] - 1)
        for k in range(P):
            p[k, i] = constants[turn, k]
        f[X, i], f[Y, i], f[SPEED, i], f[COS, i] = x, lanes[lane, LANE_Y], speed, 1.0
        g[KIND, i] = kinds[which]
        g[LANE, i] = g[TARGET, i] = closest_lane(lanes, x, f[Y, i], 0.0)
        g[ON, i] = lanes_at(lanes, x, f[Y, i])
        g[CHECKS, i] = 1 if i == 0 or checks else 0
        g[CHANGES, i], g[CRASHED, i] = 1, 0
        f[TARGET_SPEED, i] = speed
        if i == 0:
            if kinds[0] == EGO:
                f[TARGET_SPEED, i] = target_speeds[speed_index(target_speeds, speed)]
            continue
        f[TIMER, i] = ((x + f[Y, i]) * math.pi) % p[DELAY, i]
        randomize(row, kinds[1], rules.ranges, p, i)
