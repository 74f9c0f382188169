"""What vehicles do in a frame: which lane they are bound for, their wheel and throttle; highway-env's `Road.act`."""

from __future__ import annotations

import math

from dynamics.compiled import inlined, uncounted
from dynamics.networks.lanes import heading_at, least_across, local, on_lane, reachable
from dynamics.networks.layout import ACROSS, ALONG, COUNT, ID, ROAD, ROUTE, ROUTE_END
from dynamics.networks.network import Network
from dynamics.networks.routes import follow_road
from dynamics.simulator.arithmetic import clip, not_zero
from dynamics.simulator.control import KP_A, KP_LATERAL, pursue
from dynamics.simulator.layout import (
    ACC_MAX,
    ACCELERATION,
    CHANGES,
    COMFORT,
    CRASHED,
    DELAY,
    DELTA,
    EGO,
    GAIN,
    IDM,
    IMPOSED,
    KIND,
    LANE,
    LANE_LENGTH,
    LANE_WIDTH,
    OBSTACLE,
    POLITENESS,
    SPEED,
    TARGET,
    TARGET_SPEED,
    TIMER,
    X,
    Y,
)
from dynamics.simulator.loops import at_two
from dynamics.simulator.traffic import desired_gap, free_flow, wanted_share
from dynamics.state import FloatArray, IntArray

__all__ = ["act"]

_POWER = 5
_PURSUIT = 0.5 * 0.2
"""`ControlledVehicle.TAU_PURSUIT`: how far ahead the lane's direction is taken [s]."""
_MARGIN = 1.0


@inlined
def _on(
    sums: int, loops: IntArray, network: Network, f: FloatArray, g: IntArray, i: int, lane: int
) -> tuple[float, float]:
    """(s, r) of a vehicle on a lane [m]; on its own it is known."""
    if lane == g[LANE, i]:
        return f[ALONG, i], f[ACROSS, i]
    return local(sums, loops, network.lanes, network.ids, lane, f[X, i], f[Y, i])


@uncounted
def _neighbours(
    sums: int, loops: IntArray, network: Network, f: FloatArray, g: IntArray, i: int, lane: int
) -> tuple[int, int]:
    """Who is next ahead and behind of a body on a lane, -1 for nobody; see `dynamics.simulator.neighbours`."""
    lanes, ids, linked = network.lanes, network.ids, network.linked
    s = _on(sums, loops, network, f, g, i, lane)[0]
    front, rear, ahead, behind = -1, -1, 0.0, 0.0
    for v in range(f.shape[1]):
        if v == i:
            continue
        for k in range(-1, linked.shape[1]):
            other = lane if k < 0 else linked[lane, k, 0]
            if other < 0:
                break
            if least_across(sums, lanes, ids, other, f[X, v], f[Y, v]) > lanes[other, LANE_WIDTH] / 2 + _MARGIN:
                continue
            at, r = _on(sums, loops, network, f, g, v, other)
            if not on_lane(lanes, other, at, r, _MARGIN):
                continue
            if k >= 0:
                at += lanes[lane, LANE_LENGTH] if linked[lane, k, 1] > 0 else -lanes[other, LANE_LENGTH]
            if s <= at and (front < 0 or at <= ahead):
                front, ahead = v, at
            if at < s and (rear < 0 or at > behind):
                rear, behind = v, at
            break
    return front, rear


@inlined
def _ahead(sums: int, loops: IntArray, network: Network, f: FloatArray, g: IntArray, i: int, j: int) -> float:
    """How far body j is ahead of body i on the lane of i [m]."""
    return _on(sums, loops, network, f, g, j, g[LANE, i])[0] - f[ALONG, i]


@uncounted
def _acceleration(
    sums: int,
    loops: IntArray,
    network: Network,
    f: FloatArray,
    g: IntArray,
    p: FloatArray,
    judge: int,
    body: int,
    leader: int,
) -> float:
    """IDM's acceleration of a body behind a leader by the constants of a judge [m/s^2]; -1 is nobody."""
    if body < 0 or g[KIND, body] == OBSTACLE:
        return 0.0
    share = wanted_share(f, g, network.lanes, body)
    power = share * share
    if p[DELTA, judge] != 2.0:
        power = at_two(loops[_POWER, 0], loops[_POWER, 1], share, p[DELTA, judge])
    free = free_flow(p[COMFORT, judge], power)
    if leader < 0:
        return free
    held = desired_gap(sums, f, p, judge, body, leader) / not_zero(_ahead(sums, loops, network, f, g, body, leader))
    return free - p[COMFORT, judge] * (held * held)


@inlined
def _sign(x: int) -> int:
    return (x > 0) - (x < 0)


@uncounted
def _mobil(
    sums: int,
    loops: IntArray,
    network: Network,
    f: FloatArray,
    g: IntArray,
    p: FloatArray,
    routes: IntArray,
    i: int,
    lane: int,
) -> bool:
    """Whether a vehicle changes to a lane: nobody has to brake hard for it, and it gains, or its route leads there."""
    leader, follower = _neighbours(sums, loops, network, f, g, i, lane)
    imposed = _acceleration(sums, loops, network, f, g, p, i, follower, i)
    if imposed < -p[IMPOSED, i]:
        return False
    wanted = routes[i, g[ROUTE, i], 1] if g[ROUTE, i] < g[ROUTE_END, i] else -1
    mine = _acceleration(sums, loops, network, f, g, p, i, i, leader)
    if wanted >= 0:
        target = network.ids[g[TARGET, i], ID]
        return _sign(network.ids[lane, ID] - target) == _sign(wanted - target) and not mine < -p[IMPOSED, i]
    old_leader, old_follower = _neighbours(sums, loops, network, f, g, i, g[LANE, i])
    gain = mine - _acceleration(sums, loops, network, f, g, p, i, i, old_leader)
    if p[POLITENESS, i] != 0.0:
        others = imposed - _acceleration(sums, loops, network, f, g, p, i, follower, leader)
        others += _acceleration(sums, loops, network, f, g, p, i, old_follower, old_leader)
        others -= _acceleration(sums, loops, network, f, g, p, i, old_follower, i)
        gain += p[POLITENESS, i] * others
    return not gain < p[GAIN, i]


@uncounted
def _change_lanes(
    sums: int,
    loops: IntArray,
    network: Network,
    f: FloatArray,
    g: IntArray,
    p: FloatArray,
    routes: IntArray,
    i: int,
    vehicles: int,
) -> None:
    """A vehicle's decision about its lane, in place: those after it see what it has decided."""
    ids, lane, target = network.ids, g[LANE, i], g[TARGET, i]
    if lane != target:
        if ids[lane, ROAD] != ids[target, ROAD]:
            return
        for v in range(vehicles):
            if v == i or g[LANE, v] == target or g[TARGET, v] != target:
                continue
            if 0.0 < _ahead(sums, loops, network, f, g, i, v) < desired_gap(sums, f, p, i, i, v):
                g[TARGET, i] = lane
                break
        return
    if not p[DELAY, i] < f[TIMER, i]:
        return
    f[TIMER, i] = 0.0
    for side in (-1, 1):
        if not 0 <= ids[lane, ID] + side < ids[lane, COUNT]:
            continue
        candidate = lane + side
        if abs(f[SPEED, i]) < 1.0 or not reachable(sums, loops, network.lanes, ids, candidate, f[X, i], f[Y, i]):
            continue
        if _mobil(sums, loops, network, f, g, p, routes, i, candidate):
            g[TARGET, i] = candidate


@uncounted
def _steer(
    sums: int,
    loops: IntArray,
    network: Network,
    f: FloatArray,
    g: IntArray,
    p: FloatArray,
    work: FloatArray,
    busy: IntArray,
    vehicles: int,
) -> None:
    """Steering towards the lane that each vehicle is bound for [rad]."""
    asked, ahead, n = work[1], work[0], 0
    for i in range(vehicles):
        if g[KIND, i] == EGO or (g[KIND, i] == IDM and not g[CRASHED, i]):
            lane = g[TARGET, i]
            s, r = _on(sums, loops, network, f, g, i, lane)
            ahead[n] = heading_at(loops, network.lanes, network.ids, lane, s + f[SPEED, i] * _PURSUIT)
            asked[n] = clip(-KP_LATERAL * r / not_zero(f[SPEED, i]), -1.0, 1.0)
            busy[n] = i
            n += 1
    pursue(loops, f, p, ahead, asked, work[2], busy, n)


@uncounted
def act(
    sums: int,
    loops: IntArray,
    network: Network,
    f: FloatArray,
    g: IntArray,
    p: FloatArray,
    routes: IntArray,
    work: FloatArray,
    busy: IntArray,
    vehicles: int,
) -> None:
    """Decide lanes, in turn, and then steering and acceleration of all vehicles.

    Parameters
    ----------
    routes : see `routes.follow_road`. work, busy : (4, m) and (m,), written.
    """
    for i in range(vehicles):
        if g[KIND, i] == EGO or not g[CRASHED, i]:
            follow_road(sums, loops, network, f, g, routes, i)
            if g[KIND, i] == IDM and g[CHANGES, i]:
                _change_lanes(sums, loops, network, f, g, p, routes, i, vehicles)
    for i in range(vehicles):
        if g[KIND, i] == EGO:
            f[ACCELERATION, i] = KP_A * (f[TARGET_SPEED, i] - f[SPEED, i])
        elif not g[CRASHED, i]:
            wanted = math.inf
            for lane in (g[LANE, i], g[TARGET, i]):
                leader = _neighbours(sums, loops, network, f, g, i, lane)[0]
                wanted = min(wanted, _acceleration(sums, loops, network, f, g, p, i, i, leader))
                if lane == g[TARGET, i]:
                    break
            f[ACCELERATION, i] = clip(wanted, -p[ACC_MAX, i], p[ACC_MAX, i])
    _steer(sums, loops, network, f, g, p, work, busy, vehicles)
