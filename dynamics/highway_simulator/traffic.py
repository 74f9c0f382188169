"""Driving models of highway-env's traffic: IDM, the linear model, and MOBIL.

Treiber, Hennecke and Helbing 2000; Kesting, Treiber and Helbing 2007; the details are those of highway-env's
`vehicle/behavior.py`. A vehicle computes the acceleration of another vehicle with its own constants; parameter `driver`
is the vehicle that computes.
"""

from __future__ import annotations

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.arithmetic import clip, dot2, dot3, not_zero
from dynamics.highway_simulator.arrays import Bodies, LaneNeighbours, Machine
from dynamics.highway_simulator.lanes import reachable
from dynamics.highway_simulator.layout import (
    A_GAP,
    A_LEADER,
    A_SPEED,
    COMFORT,
    CONTINUOUS,
    COS,
    DELAY,
    DELTA,
    DISTANCE,
    GAIN,
    IMPOSED,
    KIND,
    LANE,
    LANE_LIMIT,
    LINEAR,
    OBSTACLE,
    POLITENESS,
    SIN,
    SPEED,
    TARGET,
    TARGET_SPEED,
    TIME,
    TIMER,
    TWICE_ROOT,
    X,
    Y,
)
from dynamics.highway_simulator.loops import at_two
from dynamics.state import FloatArray, IntArray
from dynamics.traffic.mobil import desired_gap_with

__all__ = [
    "acceleration",
    "acceleration_behind_leader",
    "change_lanes",
    "desired_gap",
    "free_flow",
    "free_flow_of",
    "linear",
    "target_speed_ratio",
]

_POWER = 5


@kernel_inline
def desired_gap(sums: int, f: FloatArray, p: FloatArray, driver: int, body: int, leader: int) -> float:
    """IDM's desired gap d* of a body to the one ahead [m]; it may be negative if that one is much faster."""
    v, w = f[SPEED, body], f[SPEED, leader]
    c, s = f[COS, body], f[SIN, body]
    closing = dot2(sums, v * c - w * f[COS, leader], c, v * s - w * f[SIN, leader], s)
    return desired_gap_with(p[DISTANCE, driver], p[TIME, driver], p[TWICE_ROOT, driver], v, closing)


@kernel_inline
def target_speed_ratio(f: FloatArray, g: IntArray, lanes: FloatArray, body: int) -> float:
    """Speed of a body divided by its target speed, limited to the speed limit of its lane."""
    target = 0.0 if g[KIND, body] == CONTINUOUS else f[TARGET_SPEED, body]
    return max(f[SPEED, body], 0.0) / abs(not_zero(clip(target, 0.0, lanes[g[LANE, body], LANE_LIMIT])))


@kernel_inline
def free_flow(comfort: float, power: float) -> float:
    """IDM's acceleration on an empty road [m/s^2], given the speed divided by the target speed, to the power delta."""
    return comfort * (1.0 - power)


@kernel_inline
def free_flow_of(
    loops: IntArray, f: FloatArray, g: IntArray, p: FloatArray, lanes: FloatArray, driver: int, body: int
) -> float:
    """IDM's acceleration of a body on an empty road by the constants of vehicle `driver` [m/s^2]; lanes : (n,
    LANE_COLUMNS)."""
    share = target_speed_ratio(f, g, lanes, body)
    power = share * share
    if p[DELTA, driver] != 2.0:
        power = at_two(loops[_POWER, 0], loops[_POWER, 1], share, p[DELTA, driver])
    return free_flow(p[COMFORT, driver], power)


@kernel_inline
def acceleration_behind_leader(
    sums: int, f: FloatArray, p: FloatArray, driver: int, body: int, leader: int, ahead: float, free: float
) -> float:
    """IDM's acceleration of a body at distance `ahead` [m] behind a leader, given that on an empty road [m/s^2]."""
    gap_ratio = desired_gap(sums, f, p, driver, body, leader) / not_zero(ahead)
    return free - p[COMFORT, driver] * (gap_ratio * gap_ratio)


@kernel_inline
def linear(
    sums: int, f: FloatArray, g: IntArray, p: FloatArray, driver: int, body: int, leader: int, ahead: float
) -> float:
    """The linear model's acceleration of a body by the constants of vehicle `driver` [m/s^2].

    Parameters
    ----------
    body, leader : -1 for none. ahead : distance from the body to the leader [m]; not read without a leader.
    """
    if body < 0:
        return dot3(sums, p[A_SPEED, driver], 0.0, p[A_LEADER, driver], 0.0, p[A_GAP, driver], 0.0)
    v = f[SPEED, body]
    own = g[KIND, body] == CONTINUOUS or g[KIND, body] == OBSTACLE
    faster = (v if own else f[TARGET_SPEED, body]) - v
    closing, gap_error = 0.0, 0.0
    if leader >= 0:
        closing = min(f[SPEED, leader] - v, 0.0)
        gap_error = min(ahead - (p[DISTANCE, driver] + max(v, 0.0) * p[TIME, driver]), 0.0)
    return dot3(sums, p[A_SPEED, driver], faster, p[A_LEADER, driver], closing, p[A_GAP, driver], gap_error)


@kernel_inline
def acceleration(machine: Machine, bodies: Bodies, driver: int, body: int, leader: int, free: float) -> float:
    """Acceleration of a body behind a leader, by the model and the constants of vehicle `driver` [m/s^2].

    Parameters
    ----------
    body, leader : -1 for none.
    free : `free_flow` of `driver` itself. For another body it is computed here.
    """
    sums, f, g, p = machine.sums, bodies.f, bodies.g, bodies.p
    if g[KIND, driver] == LINEAR:
        ahead = f[X, leader] - f[X, body] if body >= 0 and leader >= 0 else 0.0
        return linear(sums, f, g, p, driver, body, leader, ahead)
    if body < 0 or g[KIND, body] == OBSTACLE:
        return 0.0
    if body != driver:
        free = free_flow_of(machine.loops, f, g, p, bodies.lanes, driver, body)
    if leader < 0:
        return free
    return acceleration_behind_leader(sums, f, p, driver, body, leader, f[X, leader] - f[X, body], free)


@kernel_no_refcount
def _mobil(machine: Machine, bodies: Bodies, near: LaneNeighbours, i: int, lane: int, own: tuple[float, float]) -> bool:
    """Whether a vehicle changes to a lane: no vehicle has to brake hard for it, and it gains. `own` as in
    `change_lanes`.

    Cheap conditions are checked first. The order does not change the result.
    """
    g, p, front, rear, free, present = bodies.g, bodies.p, near.front, near.rear, own[0], own[1]
    leader = front[lane, i]
    gain = acceleration(machine, bodies, i, i, leader, free) - present
    if p[POLITENESS, i] == 0.0 and gain < p[GAIN, i]:
        return False
    follower = rear[lane, i]
    imposed = acceleration(machine, bodies, i, follower, i, free)
    if imposed < -p[IMPOSED, i]:
        return False
    if p[POLITENESS, i] != 0.0:
        old_leader = front[g[LANE, i], i]
        old_follower = rear[g[LANE, i], i]
        others = imposed - acceleration(machine, bodies, i, follower, leader, free)
        others += acceleration(machine, bodies, i, old_follower, old_leader, free)
        others -= acceleration(machine, bodies, i, old_follower, i, free)
        gain += p[POLITENESS, i] * others
    return not gain < p[GAIN, i]


@kernel_no_refcount
def change_lanes(
    machine: Machine,
    bodies: Bodies,
    near: LaneNeighbours,
    i: int,
    changers: IntArray,
    changing: int,
    own: tuple[float, float],
) -> int:
    """Update the target lane of a vehicle in place. Vehicles with a higher index see the result.

    Parameters
    ----------
    changers, changing : the vehicles that are changing lanes, and their number. The vehicle may be added.
    own : its acceleration on an empty road, and in its lane [m/s^2].

    Returns
    -------
    The number of vehicles that are changing lanes.
    """
    f, g, p, lanes = bodies.f, bodies.g, bodies.p, bodies.lanes
    lane, target = g[LANE, i], g[TARGET, i]
    if lane != target:
        for k in range(changing):
            v = changers[k]
            if v == i or g[LANE, v] == target or g[TARGET, v] != target:
                continue
            if 0.0 < f[X, v] - f[X, i] < desired_gap(machine.sums, f, p, i, i, v):
                g[TARGET, i] = lane
                break
        return changing
    if not p[DELAY, i] < f[TIMER, i]:
        return changing
    f[TIMER, i] = 0.0
    for side in (-1, 1):
        candidate = lane + side
        if candidate < 0 or candidate >= len(lanes):
            continue
        if not reachable(lanes, candidate, f[X, i], f[Y, i]) or abs(f[SPEED, i]) < 1.0:
            continue
        if _mobil(machine, bodies, near, i, candidate, own):
            g[TARGET, i] = candidate
    if g[TARGET, i] != lane:
        changers[changing] = i
        changing += 1
    return changing
