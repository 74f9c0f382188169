"""Lane choice, steering and acceleration of all vehicles in a frame: highway-env's `Road.act`."""

from __future__ import annotations

import math

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.arithmetic import clip, not_zero
from dynamics.highway_simulator.control import KP_A, KP_LATERAL, free_flow_of_all, linear_wheel, pursue
from dynamics.highway_simulator.lanes import MARGIN
from dynamics.highway_simulator.layout import (
    ACC_MAX,
    ACCELERATION,
    ALLY,
    CHANGES,
    COMFORT,
    CONTINUOUS,
    CRASHED,
    DELAY,
    EGO,
    GAIN,
    HEADING,
    IDM,
    IMPOSED,
    KIND,
    LANE,
    LANE_LENGTH,
    LANE_WIDTH,
    LINEAR,
    OBSTACLE,
    POLITENESS,
    SPEED,
    STEERING,
    TARGET,
    TARGET_SPEED,
    TIMER,
    X,
    Y,
)
from dynamics.highway_simulator.traffic import acceleration_behind_leader, desired_gap, free_flow_of, linear
from dynamics.road_networks.geometry.lanes import heading_at, least_across, local, on_lane, reachable, straight
from dynamics.road_networks.geometry.layout import (
    ACROSS,
    ALONG,
    COUNT,
    ID,
    ROAD,
    ROUTE,
    ROUTE_END,
    SHAPE,
    STRAIGHT,
    USES_CONTROLLERS,
)
from dynamics.road_networks.geometry.routes import NetworkTraffic, follow_road, on_lane_of
from dynamics.state import FloatArray, IntArray

__all__ = ["act"]

_PURSUIT = 0.5 * 0.2
"""`ControlledVehicle.TAU_PURSUIT`: time ahead at which the lane's heading is taken [s]."""


@kernel_inline
def _neighbours(traffic: NetworkTraffic, i: int, lane: int) -> tuple[int, int]:
    """The next bodies ahead of and behind a body on a lane, -1 for none; see
    `dynamics.highway_simulator.neighbours`."""
    lanes, f, linked = traffic.lanes, traffic.f, traffic.network.linked
    s = on_lane_of(traffic, i, lane)[0]
    front, rear, ahead, behind = -1, -1, 0.0, 0.0
    for v in range(traffic.bodies):
        if v == i:
            continue
        for k in range(-1, linked.shape[1]):
            other = lane if k < 0 else linked[lane, k, 0]
            if other < 0:
                break
            row = lanes.rows[other]
            if other == traffic.g[LANE, v]:
                at, r = f[ALONG, v], f[ACROSS, v]
            elif lanes.ids[other, SHAPE] == STRAIGHT:
                at, r = straight(lanes.sums, row, f[X, v], f[Y, v])
            elif least_across(lanes, other, f[X, v], f[Y, v]) > row[LANE_WIDTH] / 2 + MARGIN:
                continue
            else:
                at, r = local(lanes, other, f[X, v], f[Y, v])
            if not on_lane(lanes.rows, other, at, r, MARGIN):
                continue
            if k >= 0:
                at += lanes.rows[lane, LANE_LENGTH] if linked[lane, k, 1] > 0 else -lanes.rows[other, LANE_LENGTH]
            if s <= at and (front < 0 or at <= ahead):
                front, ahead = v, at
            if at < s and (rear < 0 or at > behind):
                rear, behind = v, at
            break
    return front, rear


@kernel_inline
def _ahead(traffic: NetworkTraffic, i: int, j: int) -> float:
    """Distance from body i to body j along the lane of i [m]."""
    return on_lane_of(traffic, j, traffic.g[LANE, i])[0] - traffic.f[ALONG, i]


@kernel_inline
def _acceleration(traffic: NetworkTraffic, driver: int, body: int, leader: int, free: float) -> float:
    """Acceleration of a body behind a leader, by the model and the constants of vehicle `driver` [m/s^2].

    Parameters
    ----------
    body, leader : -1 for none.
    free : acceleration of `driver` on an empty road. For another body it is computed here.
    """
    lanes, f, g, p = traffic.lanes, traffic.f, traffic.g, traffic.p
    if g[KIND, driver] == LINEAR:
        ahead = _ahead(traffic, body, leader) if body >= 0 and leader >= 0 else 0.0
        return linear(lanes.sums, f, g, p, driver, body, leader, ahead)
    if body < 0 or g[KIND, body] == OBSTACLE:
        return 0.0
    if body != driver:
        free = free_flow_of(lanes.loops, f, g, p, lanes.rows, driver, body)
    if leader < 0:
        return free
    return acceleration_behind_leader(lanes.sums, f, p, driver, body, leader, _ahead(traffic, body, leader), free)


@kernel_inline
def _sign(x: int) -> int:
    return (x > 0) - (x < 0)


@kernel_no_refcount
def _mobil(traffic: NetworkTraffic, i: int, lane: int, free: float) -> bool:
    """Whether a vehicle changes to a lane: no vehicle has to brake hard for it, and it gains or its route leads
    there."""
    ids, g, p, routes = traffic.lanes.ids, traffic.g, traffic.p, traffic.routes
    leader, follower = _neighbours(traffic, i, lane)
    imposed = _acceleration(traffic, i, follower, i, free)
    if imposed < -p[IMPOSED, i]:
        return False
    wanted = routes[i, g[ROUTE, i], 1] if g[ROUTE, i] < g[ROUTE_END, i] else -1
    mine = _acceleration(traffic, i, i, leader, free)
    if wanted >= 0:
        target = ids[g[TARGET, i], ID]
        return _sign(ids[lane, ID] - target) == _sign(wanted - target) and not mine < -p[IMPOSED, i]
    old_leader, old_follower = _neighbours(traffic, i, g[LANE, i])
    gain = mine - _acceleration(traffic, i, i, old_leader, free)
    if p[POLITENESS, i] != 0.0:
        others = imposed - _acceleration(traffic, i, follower, leader, free)
        others += _acceleration(traffic, i, old_follower, old_leader, free)
        others -= _acceleration(traffic, i, old_follower, i, free)
        gain += p[POLITENESS, i] * others
    return not gain < p[GAIN, i]


@kernel_no_refcount
def _abort_lane_change(traffic: NetworkTraffic, i: int, vehicles: int) -> None:
    """Abort a lane change if a vehicle ahead is changing to the same lane."""
    lanes, f, g, p = traffic.lanes, traffic.f, traffic.g, traffic.p
    ids, lane, target = lanes.ids, g[LANE, i], g[TARGET, i]
    if ids[lane, ROAD] != ids[target, ROAD]:
        return
    for v in range(vehicles):
        if v == i or g[LANE, v] == target or g[TARGET, v] != target or g[KIND, v] == CONTINUOUS:
            continue
        if 0.0 < _ahead(traffic, i, v) < desired_gap(lanes.sums, f, p, i, i, v):
            g[TARGET, i] = lane
            break


@kernel_no_refcount
def _choose_lane(traffic: NetworkTraffic, i: int, free: float) -> None:
    """Choose a target lane by MOBIL, when the vehicle's timer is due."""
    lanes, f, g = traffic.lanes, traffic.f, traffic.g
    ids, lane = lanes.ids, g[LANE, i]
    f[TIMER, i] = 0.0
    for side in (-1, 1):
        if not 0 <= ids[lane, ID] + side < ids[lane, COUNT]:
            continue
        candidate = lane + side
        if abs(f[SPEED, i]) < 1.0 or not reachable(lanes, candidate, f[X, i], f[Y, i]):
            continue
        if _mobil(traffic, i, candidate, free):
            g[TARGET, i] = candidate


@kernel_inline
def _change_lanes(traffic: NetworkTraffic, i: int, vehicles: int, free: float) -> None:
    """Update the target lane of a vehicle in place. Vehicles with a higher index see the result."""
    if traffic.g[LANE, i] != traffic.g[TARGET, i]:
        _abort_lane_change(traffic, i, vehicles)
    elif traffic.p[DELAY, i] < traffic.f[TIMER, i]:
        _choose_lane(traffic, i, free)


@kernel_no_refcount
def _steer(traffic: NetworkTraffic, work: FloatArray, busy: IntArray, vehicles: int) -> None:
    """Steering of each vehicle towards its target lane [rad]."""
    lanes, f, g, p = traffic.lanes, traffic.f, traffic.g, traffic.p
    heading_sine, ahead, n = work[1], work[0], 0
    for i in range(vehicles):
        lane = g[TARGET, i]
        if g[KIND, i] == LINEAR and not g[CRASHED, i]:
            s, r = on_lane_of(traffic, i, lane)
            future = heading_at(lanes, lane, s + f[SPEED, i] * _PURSUIT)
            f[STEERING, i] = linear_wheel(lanes.sums, lanes.loops, f, p, i, future, r)
        elif g[KIND, i] in (EGO, ALLY) or g[USES_CONTROLLERS, i] or (g[KIND, i] == IDM and not g[CRASHED, i]):
            s, r = on_lane_of(traffic, i, lane)
            ahead[n] = heading_at(lanes, lane, s + f[SPEED, i] * _PURSUIT)
            if r == 0.0 and f[HEADING, i] == ahead[n] and f[SPEED, i] >= 0.0:
                f[STEERING, i] = 0.0
                continue
            heading_sine[n] = clip(-KP_LATERAL * r / not_zero(f[SPEED, i]), -1.0, 1.0)
            busy[n] = i
            n += 1
    pursue(lanes.loops, f, p, ahead, heading_sine, work[2], busy, n)


@kernel_no_refcount
def act(traffic: NetworkTraffic, work: FloatArray, busy: IntArray, vehicles: int) -> None:
    """Target lanes of all vehicles, one after the other; then steering and acceleration.

    Parameters
    ----------
    work, busy : buffers, (4, m) and (m,), written.
    """
    lanes, f, g, p, free = traffic.lanes, traffic.f, traffic.g, traffic.p, work[0]
    free_flow_of_all(lanes.loops, f, g, p, lanes.rows, work, vehicles)
    for i in range(vehicles):
        if g[KIND, i] == CONTINUOUS:
            if g[USES_CONTROLLERS, i]:
                follow_road(traffic, i)
        elif g[KIND, i] in (EGO, ALLY) or not g[CRASHED, i]:
            follow_road(traffic, i)
            if g[KIND, i] in (IDM, LINEAR) and g[CHANGES, i]:
                _change_lanes(traffic, i, vehicles, free[i])
    for i in range(vehicles):
        if g[KIND, i] in (EGO, ALLY):
            f[ACCELERATION, i] = KP_A * (f[TARGET_SPEED, i] - f[SPEED, i])
        elif g[KIND, i] == CONTINUOUS:
            if g[USES_CONTROLLERS, i]:
                f[ACCELERATION, i] = clip(KP_A * (f[TARGET_SPEED, i] - f[SPEED, i]), -p[ACC_MAX, i], p[COMFORT, i])
        elif not g[CRASHED, i]:
            wanted = math.inf
            for lane in (g[LANE, i], g[TARGET, i]):
                leader = _neighbours(traffic, i, lane)[0]
                wanted = min(wanted, _acceleration(traffic, i, i, leader, free[i]))
                if lane == g[TARGET, i]:
                    break
            f[ACCELERATION, i] = clip(wanted, -p[ACC_MAX, i], p[ACC_MAX, i])
    _steer(traffic, work, busy, vehicles)
