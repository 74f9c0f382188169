"""highway-env's bicycle and low-level control as compiled loops: many rollouts over many frames in one call.

The formulas are those of `dynamics.vehicle.bicycle`, `dynamics.vehicle.controllers` and, on curved roads,
`dynamics.vehicle.curved_bicycle`, for one vehicle at a time and in scalars. A road is a table (8, pieces). Its rows are
the start of each piece of the path [m]; the curvature before it, on it and after it [1/m]; the s range that it covers,
from and to [m]; and, repeated, the length of the path [m] and 1 if it is closed. The table of a straight road has no
pieces.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.roads.arcs import STRAIGHT
from dynamics.roads.path import CurvatureProfile, PathRoad
from dynamics.state import FloatArray, IntArray
from dynamics.vehicle.bicycle import LENGTH, MAX_SPEED
from dynamics.vehicle.controllers import KP_HEADING, KP_LATERAL, KP_SPEED, MAX_SLIP

__all__ = [
    "NO_LIMIT",
    "StopTarget",
    "StopTargets",
    "roll_brakes",
    "roll_commands",
    "roll_frame",
    "roll_inputs",
    "roll_stop",
    "roll_stops",
    "roll_targets",
    "slip_at",
    "table_of",
]

NO_LIMIT = 1e12
"""Deceleration bound without effect [m/s^2]."""
_NONZERO = 1e-2
"""The least speed that highway-env divides by [m/s]."""
_STRAIGHT = np.zeros((8, 0))
_MOST_HEADING = math.sin(math.pi / 4)
_FAR = 1e9
"""Coordinate at which an open path's first piece begins and its last piece ends [m]."""
_NEAREST = 0.1
"""Least assumed distance from the centre of a bend, as a share of its radius."""
_MOST_BEND = 0.7
"""Greatest sine of the slip angle commanded for a bend; the wheel's limit allows 0.65."""


class StopTarget(NamedTuple):
    """A target that is tracked, and the stop after it.

    Attributes
    ----------
    goal, last_goal : lateral positions before and during braking [m]. speed : tracked before braking [m/s].
    commit : number of frames before braking. braking : deceleration of the stop [m/s^2].
    """

    goal: float
    last_goal: float
    speed: float
    commit: int
    braking: float


class StopTargets(NamedTuple):
    """The same for n candidates.

    Attributes
    ----------
    lanes, fails : target lane of each candidate before and during braking, (n,). speeds : target speeds, (n,) [m/s].
    commit, braking : as in `StopTarget`.
    """

    lanes: IntArray
    fails: IntArray
    speeds: FloatArray
    commit: int
    braking: float


def table_of(road: Any) -> FloatArray:
    """The table of a road; without pieces for a straight road or None."""
    if not isinstance(road, PathRoad):
        return _STRAIGHT
    return _table(road.profile)


@lru_cache(maxsize=64)
def _table(profile: CurvatureProfile) -> FloatArray:
    """The table of a path (8, pieces), see the head of this module."""
    breaks, k = np.array(profile.breaks), np.array(profile.curvatures)
    starts, ends, before, after = breaks[:-1].copy(), breaks[1:].copy(), np.roll(k, 1), np.roll(k, -1)
    if not profile.closed:
        starts[0], ends[-1], before[0], after[-1] = -_FAR, _FAR, k[0], k[-1]
    return np.stack([breaks[:-1], before, k, after, starts, ends, np.full(k.size, breaks[-1]), k * 0 + profile.closed])


@kernel_inline
def _piece(table: FloatArray, s: float) -> tuple[int, float]:
    """The piece of the path at arc length s [m], and s on the first lap [m]."""
    within = s - table[6, 0] * math.floor(s / table[6, 0]) if table[7, 0] > 0 else s
    low, high = 0, table.shape[1]
    while high - low > 1:
        middle = (low + high) // 2
        if table[0, middle] <= within:
            low = middle
        else:
            high = middle
    return low, within


@kernel_inline
def _project(x: float, y: float, k: float) -> tuple[float, float]:
    """(s, r) [m] of a point (x, y) [m] in the frame of the start of an arc of curvature k [1/m]; see
    `dynamics.roads.arcs`."""
    rest, bent = 1 - k * y, k * x
    s = math.atan2(bent, rest) / k if abs(k) >= STRAIGHT else x
    return s, (2 * y - k * (x * x + y * y)) / (1 + math.sqrt(rest * rest + bent * bent))


@kernel_inline
def roll_frame(
    state: tuple[float, float, float, float],
    facing: tuple[float, float],
    a: float,
    slip: float,
    table: FloatArray,
    dt: float,
) -> tuple[float, float, float, float]:
    """One simulation frame: `bicycle.slip_step`, and on a path the projection of `curved_bicycle`. `facing` is sine and
    cosine of the heading."""
    s, r, psi, v = state
    sin, cos = facing
    if v > MAX_SPEED:
        a = min(a, MAX_SPEED - v)
    if v < -MAX_SPEED:
        a = max(a, -MAX_SPEED - v)
    way, ahead = v * dt, math.sqrt(1 - slip * slip)
    dx, y = way * (cos * ahead - sin * slip), r + way * (sin * ahead + cos * slip)
    heading, speed = psi + way * slip * (2 / LENGTH), v + a * dt
    if table.shape[1] == 0:
        return s + dx, y, heading, speed
    i, within = _piece(table, s)
    k, joints, turned, way = table[2, i], 0.0, 0.0, 0
    along, across = _project(dx, y, k)
    # If rounding puts the start just outside its piece, the joint is at the start itself, which gives the same result.
    for _ in range(table.shape[1]):
        if way >= 0 and along > table[5, i] - within:
            joint, way = table[5, i] - within, 1
        elif way <= 0 and along < table[4, i] - within:
            joint, way = table[4, i] - within, -1
        else:
            break
        turn = k * joint
        sin, cos = math.sin(turn), math.cos(turn)
        if abs(k) >= STRAIGHT:
            dx, y = dx - sin / k, y - 2 * math.sin(turn / 2) ** 2 / k
        else:
            dx = dx - joint
        dx, y = cos * dx + sin * y, cos * y - sin * dx
        joints, turned, i = joints + joint, turned + turn, (i + way) % table.shape[1]
        k, within = table[2, i], table[4, i] if way > 0 else table[5, i]
        along, across = _project(dx, y, k)
    return s + joints + along, across, heading - turned - k * along, speed


@kernel_inline
def slip_at(s: float, r: float, psi: float, v: float, goal: float, table: FloatArray, dt: float) -> float:
    """Sine of the slip angle that steers a road state to lateral position `goal` [m].

    Source: `ControlledVehicle.steering_control` of highway-env 1.12; on a path, the control of
    `dynamics.vehicle.curved_bicycle`.
    """
    if abs(v) < _NONZERO:
        v = _NONZERO if v >= 0 else -_NONZERO
    heading = math.asin(min(max(KP_LATERAL * (goal - r) / v, -_MOST_HEADING), _MOST_HEADING))
    bend = 0.0
    if table.shape[1] > 0:
        k = table[2, _piece(table, s)[0]]
        kappa = k / max(1 - k * r, _NEAREST)
        bend = min(max(LENGTH / 2 * kappa, -_MOST_BEND), _MOST_BEND)
        heading = heading + min(max(kappa * v * (dt / 2), -_MOST_BEND), _MOST_BEND) - math.asin(bend)
    angle = heading - psi
    if abs(angle) > 3.0:  # smaller angles need no wrapping, which saves a division
        angle = angle - 2 * math.pi * math.floor((angle + math.pi) / (2 * math.pi))
    return min(max((LENGTH / 2 * KP_HEADING) * angle / v + bend, -MAX_SLIP), MAX_SLIP)


@kernel_no_refcount
def _step(
    state: tuple[float, float, float, float], a: float, slip: float, table: FloatArray, dt: float
) -> tuple[float, float, float, float]:
    """`roll_frame`, with sine and cosine computed from the heading."""
    return roll_frame(state, (math.sin(state[2]), math.cos(state[2])), a, slip, table, dt)


@kernel_no_refcount
def roll_commands(start: FloatArray, commands: FloatArray, table: FloatArray, dt: float, paths: FloatArray) -> None:
    """Roll out commands (n, frames, 3) from states (n, 4); `paths` (n, frames, 4), states after each frame, written."""
    for i in range(start.shape[0]):
        s, r, psi, v = start[i, 0], start[i, 1], start[i, 2], start[i, 3]
        for f in range(commands.shape[1]):
            a = max(max(KP_SPEED * (commands[i, f, 1] - v), -commands[i, f, 2]), max(v, 0.0) * (-1 / dt))
            slip = slip_at(s, r, psi, v, commands[i, f, 0], table, dt)
            s, r, psi, v = _step((s, r, psi, v), a, slip, table, dt)
            paths[i, f, 0], paths[i, f, 1], paths[i, f, 2], paths[i, f, 3] = s, r, psi, v


@kernel_no_refcount
def roll_stop(start: FloatArray, target: StopTarget, table: FloatArray, dt: float, path: FloatArray) -> None:
    """Roll out a stop from a state (4,); `path` (frames, 4), states after each frame, written.

    The vehicle tracks the target for `commit` frames. Then it brakes to a stop while it steers to `last_goal`.
    """
    goal, last_goal, speed, commit, braking = target
    s, r, psi, v = start[0], start[1], start[2], start[3]
    for f in range(path.shape[0]):
        to, a = goal, KP_SPEED * (speed - v)
        if f >= commit:
            to, a = last_goal, -braking
        slip = slip_at(s, r, psi, v, to, table, dt)
        s, r, psi, v = _step((s, r, psi, v), max(a, max(v, 0.0) * (-1 / dt)), slip, table, dt)
        path[f, 0], path[f, 1], path[f, 2], path[f, 3] = s, r, psi, v


@kernel_no_refcount
def roll_targets(
    start: FloatArray,
    centers: FloatArray,
    targets: StopTargets,
    table: FloatArray,
    dt: float,
    paths: FloatArray,
) -> None:
    """`roll_stop` for n candidates; `paths` (n, frames, 4), written.

    Parameters
    ----------
    start : road state, (4,). centers : of the lanes [m].
    """
    lanes, fails, speeds = targets.lanes, targets.fails, targets.speeds
    for i in range(paths.shape[0]):
        target = StopTarget(centers[lanes[i]], centers[fails[i]], speeds[i], targets.commit, targets.braking)
        roll_stop(start, target, table, dt, paths[i])


@kernel_no_refcount
def roll_brakes(
    began: FloatArray, goals: FloatArray, braking: float, table: FloatArray, dt: float, paths: FloatArray
) -> None:
    """Continue paths (n, h, 4) with braking to a stop while steering to the lines `goals` (n k,); `paths` (n k, frames,
    4), written. Each path has k continuations."""
    each, first = paths.shape[0] // began.shape[0], began.shape[1]
    for i in range(paths.shape[0]):
        of = i // each
        for f in range(first):
            for c in range(4):
                paths[i, f, c] = began[of, f, c]
        s, r, psi, v = (
            began[of, first - 1, 0],
            began[of, first - 1, 1],
            began[of, first - 1, 2],
            began[of, first - 1, 3],
        )
        for f in range(first, paths.shape[1]):
            a = max(-braking, max(v, 0.0) * (-1 / dt))
            slip = slip_at(s, r, psi, v, goals[i], table, dt)
            s, r, psi, v = _step((s, r, psi, v), a, slip, table, dt)
            paths[i, f, 0], paths[i, f, 1], paths[i, f, 2], paths[i, f, 3] = s, r, psi, v


@kernel_no_refcount
def roll_inputs(start: FloatArray, inputs: FloatArray, table: FloatArray, dt: float, paths: FloatArray) -> None:
    """Roll out inputs (n, frames, 2) from states (n, 4); `paths` (n, frames, 4), states after each frame, written."""
    for i in range(start.shape[0]):
        s, r, psi, v = start[i, 0], start[i, 1], start[i, 2], start[i, 3]
        for f in range(inputs.shape[1]):
            half = 0.5 * math.tan(inputs[i, f, 1])
            slip = half / math.sqrt(1 + half * half)
            s, r, psi, v = _step((s, r, psi, v), inputs[i, f, 0], slip, table, dt)
            paths[i, f, 0], paths[i, f, 1], paths[i, f, 2], paths[i, f, 3] = s, r, psi, v


@kernel_no_refcount
def roll_stops(
    start: FloatArray, stops: FloatArray, hold: int, table: FloatArray, dt: float, paths: FloatArray
) -> None:
    """Roll out stops (n, 3) of `dynamics.vehicle.braking_rollouts` from states (n, 4), with inputs constant for `hold`
    frames; `paths` (n, frames, 4), states after each frame, written."""
    for i in range(start.shape[0]):
        s, r, psi, v = start[i, 0], start[i, 1], start[i, 2], start[i, 3]
        half = 0.5 * math.tan(stops[i, 2])
        limit = half / math.sqrt(1 + half * half)
        a, slip = 0.0, 0.0
        for f in range(paths.shape[1]):
            if f % hold == 0:
                a = -min(stops[i, 1], max(v, 0.0) / (hold * dt))
                slip = min(max(slip_at(s, r, psi, v, stops[i, 0], table, dt), -limit), limit)
            s, r, psi, v = _step((s, r, psi, v), a, slip, table, dt)
            paths[i, f, 0], paths[i, f, 1], paths[i, f, 2], paths[i, f, 3] = s, r, psi, v
