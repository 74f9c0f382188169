"""Right of way at intersections, and vehicles that leave: highway-env's `RegulatedRoad` and `IntersectionEnv`.

Every half second, vehicles of the traffic that yielded are released. Then each pair of vehicles is compared over the
next three seconds, each at its present speed along its route. If the two would meet, the one of lower priority, or else
the one behind, gets a target speed of 0.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.arithmetic import dot2
from dynamics.highway_simulator.layout import (
    CHECKS,
    CONTINUOUS,
    COS,
    CRASHED,
    IDM,
    IMPACTED,
    KIND,
    LANE,
    LANE_LENGTH,
    LANE_LIMIT,
    LENGTH,
    LINEAR,
    OBSTACLE,
    SIN,
    SPEED,
    TARGET_SPEED,
    WIDTH,
    X,
    Y,
)
from dynamics.highway_simulator.loops import at
from dynamics.road_networks.geometry.lanes import heading_at, local, place
from dynamics.road_networks.geometry.layout import (
    ACROSS,
    ALONG,
    FRAMES,
    ID,
    LEAVES,
    PRIORITY,
    ROAD,
    ROUTE,
    ROUTE_END,
    TO,
    YIELDS,
)
from dynamics.road_networks.geometry.routes import NetworkTraffic
from dynamics.road_networks.traffic.constant_inputs import predict_with_constant_inputs
from dynamics.road_networks.traffic.priority_road import HORIZON, REACH
from dynamics.state import FloatArray, IntArray

__all__ = ["INSTANTS", "TrafficRegulation", "regulate", "remove_leaving"]

INSTANTS = 11
"""Number of instants at which two vehicles are compared, `_STEP` apart [s]."""
_STEP = 0.25
_LONG, _WIDE = 1.5, 0.9
"""Factors on length and width of the vehicles in the comparison."""
_COS, _SIN = 3, 4
_REMOVED_AT = 1e6
"""Coordinate at which a vehicle that has left is kept [m]."""


class TrafficRegulation(NamedTuple):
    """Rules of a road that act on vehicles beside their driving.

    Attributes
    ----------
    period : frames between two updates of which vehicles yield; 0 for none.
    ways_cross : whether the road is a `PriorityRoad`. On it, a vehicle that follows another onto the next road yields
        to it, and vehicles too far apart to meet are not compared.
    stay : number of frames after which vehicles vanish that are near the end of a lane that leaves the road, or have no
        route; 0 for never.
    phase : number of frames of the road when the environment's count was 0.
    """

    period: int
    ways_cross: bool
    stay: int
    phase: int


@kernel_inline
def _entry(traffic: NetworkTraffic, i: int, k: int) -> int:
    """The lane of entry k of a route. If it names none, the lane with the same index as the vehicle's."""
    lanes, network, own = traffic.lanes, traffic.network, traffic.g[LANE, i]
    road, wanted = traffic.routes[i, k, 0], traffic.routes[i, k, 1]
    if wanted < 0:
        wanted = min(lanes.ids[own, ID], network.roads[road, 3] - 1)
    return network.roads[road, 2] + wanted


@kernel_no_refcount
def _predict_along_route(traffic: NetworkTraffic, i: int, path: FloatArray) -> None:
    """Positions of a vehicle at each instant at constant speed, (INSTANTS, 6), written: x, y [m], heading [rad], its
    cosine and sine; the sixth is 0 as long as these two are not computed."""
    lanes, f, g, last = traffic.lanes, traffic.f, traffic.g, traffic.g[ROUTE_END, i] - 1
    for n in range(INSTANTS):
        k, s = g[ROUTE, i], f[ALONG, i] + f[SPEED, i] * (_STEP + n * _STEP)
        lane = _entry(traffic, i, k) if k <= last else g[LANE, i]
        while k < last and s > lanes.rows[lane, LANE_LENGTH]:
            s -= lanes.rows[lane, LANE_LENGTH]
            k += 1
            lane = _entry(traffic, i, k)
        path[n, 0], path[n, 1] = place(lanes, lane, s)
        path[n, 2], path[n, 5] = heading_at(lanes, lane, s), 0.0


@kernel_no_refcount
def _reaches_into(traffic: NetworkTraffic, products: int, one: FloatArray, i: int, other: FloatArray, j: int) -> bool:
    """highway-env's `has_corner_inside`, with its way of transforming a point into the frame of the other vehicle."""
    p, sums = traffic.p, traffic.lanes.sums
    length, width = _LONG * p[LENGTH, i] / 2, _WIDE * p[WIDTH, i] / 2
    far, wide = _LONG * p[LENGTH, j] / 2, _WIDE * p[WIDTH, j] / 2
    for k in range(9):
        a, b = (k // 3 - 1) * length, (k % 3 - 1) * width
        dx = dot2(products, one[3], a, -one[4], b) + one[0] - other[0]
        dy = dot2(products, one[4], a, one[3], b) + one[1] - other[1]
        u = dot2(sums, other[3], dx, -other[4], dy)
        v = dot2(sums, other[4], dx, other[3], dy)
        if -far <= u <= far and -wide <= v <= wide:
            return True
    return False


@kernel_inline
def _turn(traffic: NetworkTraffic, at_instant: FloatArray) -> None:
    """Compute the cosine and the sine of the heading at an instant, if they are not known."""
    loops = traffic.lanes.loops
    if at_instant[5] == 0.0:
        at_instant[3] = at(loops[_COS, 0], loops[_COS, 1], at_instant[2])
        at_instant[4] = at(loops[_SIN, 0], loops[_SIN, 1], at_instant[2])
        at_instant[5] = 1.0


@kernel_no_refcount
def _meet(traffic: NetworkTraffic, products: int, paths: FloatArray, i: int, j: int) -> bool:
    """Whether two vehicles would touch at one of the instants."""
    for n in range(INSTANTS):
        one, other = paths[i, n], paths[j, n]
        dx, dy = other[0] - one[0], other[1] - one[1]
        if math.sqrt(dot2(traffic.lanes.sums, dx, dx, dy, dy)) > traffic.p[LENGTH, i]:
            continue
        _turn(traffic, one)
        _turn(traffic, other)
        if _reaches_into(traffic, products, one, i, other, j) or _reaches_into(traffic, products, other, j, one, i):
            return True
    return False


@kernel_inline
def _cannot_meet(f: FloatArray, i: int, j: int) -> bool:
    """Whether two vehicles are too far apart to meet within the horizon."""
    reach = HORIZON * (abs(f[SPEED, i]) + abs(f[SPEED, j])) + REACH
    return math.hypot(f[X, i] - f[X, j], f[Y, i] - f[Y, j]) > reach


@kernel_inline
def _follows(traffic: NetworkTraffic, i: int, j: int) -> bool:
    """Whether the road of vehicle i leads to the node at which the road of vehicle j begins."""
    ids, g = traffic.lanes.ids, traffic.g
    return ids[g[LANE, i], TO] == traffic.network.roads[ids[g[LANE, j], ROAD], 0]


@kernel_no_refcount
def _yielding_vehicle(traffic: NetworkTraffic, ways_cross: bool, i: int, j: int) -> int:
    """The vehicle of lower priority; with equal priorities, the one that has the other further ahead of it."""
    ids, f, g, sums = traffic.lanes.ids, traffic.f, traffic.g, traffic.lanes.sums
    if ways_cross and (_follows(traffic, i, j) or _follows(traffic, j, i)):
        return i if _follows(traffic, i, j) else j
    mine, theirs = ids[g[LANE, i], PRIORITY], ids[g[LANE, j], PRIORITY]
    if mine != theirs:
        return j if mine > theirs else i
    dx, dy = f[X, j] - f[X, i], f[Y, j] - f[Y, i]
    ahead = dot2(sums, f[COS, i], dx, f[SIN, i], dy)
    return i if ahead > dot2(sums, f[COS, j], -dx, f[SIN, j], -dy) else j


@kernel_no_refcount
def regulate(
    traffic: NetworkTraffic,
    regulation: TrafficRegulation,
    products: int,
    work: FloatArray,
    busy: IntArray,
    paths: FloatArray,
    vehicles: int,
) -> None:
    """Release the vehicles that yielded, and determine which vehicles yield now.

    Parameters
    ----------
    work, busy, paths : buffers, (4, m), (m,) and (m, INSTANTS, 6), written.
    """
    lanes, f, g = traffic.lanes, traffic.f, traffic.g
    for i in range(vehicles):
        if g[KIND, i] == OBSTACLE:
            continue
        if g[YIELDS, i]:
            f[TARGET_SPEED, i], g[YIELDS, i] = lanes.rows[g[LANE, i], LANE_LIMIT], 0
        if g[KIND, i] == CONTINUOUS:
            predict_with_constant_inputs(traffic, products, work, busy, i, _STEP, paths[i])
        else:
            _predict_along_route(traffic, i, paths[i])
    for i in range(vehicles - 1):
        for j in range(i + 1, vehicles):
            if g[KIND, i] == OBSTACLE or g[KIND, j] == OBSTACLE or (regulation.ways_cross and _cannot_meet(f, i, j)):
                continue
            if not _meet(traffic, products, paths, i, j):
                continue
            yields = _yielding_vehicle(traffic, regulation.ways_cross, i, j)
            if g[KIND, yields] in (IDM, LINEAR):
                f[TARGET_SPEED, yields], g[YIELDS, yields] = 0.0, 1


@kernel_no_refcount
def remove_leaving(traffic: NetworkTraffic, regulation: TrafficRegulation, vehicles: int) -> None:
    """When `customs.stay` frames have passed, remove vehicles of the traffic that are near the end of a lane that
    leaves the road, or have no route. They are moved far away."""
    lanes, f, g, p = traffic.lanes, traffic.f, traffic.g, traffic.p
    if regulation.stay == 0 or (g[FRAMES, 0] - regulation.phase) % regulation.stay != 0:
        return
    for i in range(vehicles):
        lane = g[LANE, i]
        leaves = lanes.ids[lane, LEAVES] and f[ALONG, i] >= lanes.rows[lane, LANE_LENGTH] - 4 * p[LENGTH, i]
        if g[KIND, i] in (IDM, LINEAR) and (leaves or g[ROUTE_END, i] < 0):
            f[X, i], f[Y, i], f[SPEED, i] = _REMOVED_AT * (1 + i), _REMOVED_AT, 0.0
            f[ALONG, i], f[ACROSS, i] = local(lanes, lane, f[X, i], f[Y, i])
            g[KIND, i], g[CRASHED, i], g[IMPACTED, i], g[CHECKS, i] = OBSTACLE, 1, 0, 0
