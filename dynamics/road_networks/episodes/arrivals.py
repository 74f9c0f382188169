"""Vehicles that enter and leave an intersection: highway-env's `IntersectionEnv`, in the same order of random draws."""

from __future__ import annotations

import math
from typing import NamedTuple

from dynamics.compiled import kernel_no_refcount
from dynamics.highway_simulator.arithmetic import dot2
from dynamics.highway_simulator.arrays import Machine
from dynamics.highway_simulator.layout import (
    EGO,
    IDM,
    KIND,
    LANE,
    LANE_LENGTH,
    LANE_LIMIT,
    LENGTH,
    LINEAR,
    TARGET_SPEED,
    P,
    X,
    Y,
)
from dynamics.highway_simulator.random import GeneratorRow, below, uniform
from dynamics.highway_simulator.scene import randomize, speed_index
from dynamics.road_networks.episodes.draws import normal, two_of
from dynamics.road_networks.episodes.placing import ResetTables, place_vehicle, set_route
from dynamics.road_networks.geometry.lanes import heading_at, place
from dynamics.road_networks.geometry.layout import ALONG, FRAMES, LEAVES, ROUTE_END, F, G
from dynamics.road_networks.geometry.routes import NetworkTraffic
from dynamics.road_networks.simulation.frame_kernels import (
    NetworkRules,
    NetworkWork,
    NetworkWorlds,
    advance,
    traffic_of,
)
from dynamics.state import FloatArray, IntArray

__all__ = ["ArrivalRules", "IntersectionRules", "clear_and_spawn", "spawn_intersection"]

_ARMS = 4
_FIRST, _FAST, _SPAWN_DISTANCE, _EGO_SPAWN_DISTANCE = 5.0, 8.0, 15.0, 20.0
"""Position [m] and speed [m/s] of a new vehicle, and its least distance to all others; and at the reset, to the ego
[m]."""
_SECONDS = 3
"""Time for which the traffic drives before the ego is placed [s]."""
_EGO_PLACE, _CHALLENGER_PLACE = 60.0, 60.0


class ArrivalRules(NamedTuple):
    """New vehicles of an intersection.

    Attributes
    ----------
    arms : (4,), the entrance lane of each arm; its goal has the same number. Empty on other roads.
    places : (n,), positions along the entrances at which vehicles of the reset are placed [m]. frames : per second.
    odds : probability of a new vehicle at a decision.
    goal : of the ego, -1 to draw it.
    """

    arms: IntArray
    places: FloatArray
    frames: int
    odds: float
    goal: int


class IntersectionRules(NamedTuple):
    """The constants of an intersection: of the motion, of the scenes, and of new vehicles."""

    drive: NetworkRules
    scene: ResetTables
    coming: ArrivalRules


class _Arrival(NamedTuple):
    """How a new vehicle arrives.

    Attributes
    ----------
    along : added to its position [m]. spreads : standard deviations of its position [m] and its speed [m/s].
    odds : probability that it arrives. straight : whether its goal is the opposite arm.
    """

    along: float
    spreads: tuple[float, float]
    odds: float
    straight: bool


@kernel_no_refcount
def _spawn_new(
    row: GeneratorRow, scene: ResetTables, coming: ArrivalRules, traffic: NetworkTraffic, i: int, new: _Arrival
) -> int:
    """Place a new vehicle in column `i`, if drawn and if there is room: highway-env's `_spawn_vehicle`.

    Returns
    -------
    The column after the last vehicle.
    """
    f, lanes = traffic.f, traffic.lanes
    if uniform(row, 0.0, 1.0) > new.odds:
        return i
    start, goal = two_of(row, _ARMS)
    if new.straight:
        goal = (start + 2) % _ARMS
    s = new.along + _FIRST + normal(row) * new.spreads[0]
    speed = _FAST + normal(row) * new.spreads[1]
    x, y = place(lanes, coming.arms[start], s)
    for v in range(i):
        dx, dy = f[X, v] - x, f[Y, v] - y
        if math.sqrt(dot2(lanes.sums, dx, dx, dy, dy)) < _SPAWN_DISTANCE:
            return i
    place_vehicle(scene, traffic, i, False, (x, y, heading_at(lanes, coming.arms[start], s)), speed)
    set_route(scene, traffic, i, goal)
    randomize(row, scene.kind, scene.ranges, traffic.p, i)
    return i + 1


@kernel_no_refcount
def _move_column(traffic: NetworkTraffic, source: int, goal: int) -> None:
    """Copy a vehicle to another column."""
    f, g, p, routes = traffic.f, traffic.g, traffic.p, traffic.routes
    frames = g[FRAMES, 0]
    for k in range(F):
        f[k, goal] = f[k, source]
    for k in range(G):
        g[k, goal] = g[k, source]
    for k in range(P):
        p[k, goal] = p[k, source]
    for k in range(routes.shape[1]):
        routes[goal, k, 0], routes[goal, k, 1] = routes[source, k, 0], routes[source, k, 1]
    g[FRAMES, 0] = frames


@kernel_no_refcount
def _count(worlds: NetworkWorlds, e: int, n: int) -> None:
    """Store the number of vehicles. There are no obstacles on an intersection."""
    worlds.counts[e, 0] = worlds.counts[e, 1] = n
    for i in range(n):
        worlds.order[e, i] = i


@kernel_no_refcount
def _remove_marked(worlds: NetworkWorlds, traffic: NetworkTraffic, e: int, gone: IntArray) -> None:
    """Remove the vehicles that are marked in `gone`."""
    n = 0
    for i in range(worlds.counts[e, 0]):
        if gone[i] == 0:
            if n != i:
                _move_column(traffic, i, n)
            n += 1
    _count(worlds, e, n)


@kernel_no_refcount
def _spawn_ego(row: GeneratorRow, scene: ResetTables, coming: ArrivalRules, traffic: NetworkTraffic, i: int) -> None:
    """Place the ego into column `i`."""
    lanes, f = traffic.lanes, traffic.f
    lane, goal = coming.arms[0], coming.goal
    if goal < 0:
        goal = 1 + below(row, _ARMS - 1)
    x, y = place(lanes, lane, _EGO_PLACE + 5.0 * (1.0 + normal(row)))
    limit = lanes.rows[lane, LANE_LIMIT]
    place_vehicle(scene, traffic, i, True, (x, y, heading_at(lanes, lane, _EGO_PLACE)), limit)
    if traffic.g[KIND, i] == EGO:
        set_route(scene, traffic, i, goal)
        f[TARGET_SPEED, i] = scene.target_speeds[speed_index(scene.target_speeds, limit)]


@kernel_no_refcount
def spawn_intersection(
    machine: Machine,
    worlds: NetworkWorlds,
    constants: IntersectionRules,
    work: NetworkWork,
    row: GeneratorRow,
    e: int,
) -> None:
    """Draw the scene of a reset: traffic, which drives for some seconds; a vehicle that crosses the ego's way; and the
    ego. Vehicles too near to the ego are removed."""
    rules, scene, coming = constants
    n, busy = 0, work.busy
    worlds.g[e, FRAMES, 0] = 0
    for k in range(len(coming.places)):
        frames = worlds.g[e, FRAMES, 0]
        traffic = traffic_of(machine, worlds, rules.network, e)
        n = _spawn_new(row, scene, coming, traffic, n, _Arrival(coming.places[k], (1.0, 1.0), 0.6, False))
        worlds.g[e, FRAMES, 0] = frames
    _count(worlds, e, n)
    for _ in range(_SECONDS * coming.frames):
        advance(machine, worlds, rules, work, e)
    frames = worlds.g[e, FRAMES, 0]
    traffic = traffic_of(machine, worlds, rules.network, e)
    n = _spawn_new(row, scene, coming, traffic, n, _Arrival(_CHALLENGER_PLACE, (0.1, 0.0), 1.0, True))
    _spawn_ego(row, scene, coming, traffic, n)
    worlds.g[e, FRAMES, 0] = frames
    _count(worlds, e, n + 1)
    f = worlds.f[e]
    for i in range(n + 1):
        dx, dy = f[X, i] - f[X, n], f[Y, i] - f[Y, n]
        near = math.sqrt(dot2(machine.sums, dx, dx, dy, dy)) < _EGO_SPAWN_DISTANCE
        busy[i] = 1 if i < n and near else 0
    _remove_marked(worlds, traffic, e, busy)


@kernel_no_refcount
def clear_and_spawn(
    machine: Machine,
    worlds: NetworkWorlds,
    constants: IntersectionRules,
    work: NetworkWork,
    row: GeneratorRow,
    e: int,
) -> bool:
    """Changes between two decisions: vehicles near the end of a lane that leaves the road, or without a route, vanish.
    Then a vehicle may enter.

    Returns
    -------
    Whether there was room for it.
    """
    rules, scene, coming = constants
    lanes, g, p, busy = rules.network.lanes, worlds.g[e], worlds.p[e], work.busy
    for i in range(worlds.counts[e, 0]):
        lane = g[LANE, i]
        leaves = rules.network.ids[lane, LEAVES] != 0
        leaves = leaves and worlds.f[e, ALONG, i] >= lanes[lane, LANE_LENGTH] - 4 * p[LENGTH, i]
        busy[i] = 1 if g[KIND, i] in (IDM, LINEAR) and (leaves or g[ROUTE_END, i] < 0) else 0
    traffic = traffic_of(machine, worlds, rules.network, e)
    _remove_marked(worlds, traffic, e, busy)
    n = worlds.counts[e, 0]
    if n == g.shape[1]:
        return False
    new = _Arrival(0.0, (1.0, 1.0), coming.odds, False)
    _count(worlds, e, _spawn_new(row, scene, coming, traffic, n, new))
    return True
