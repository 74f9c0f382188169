"""The traffic of a scene on a network, and the choice of the next lane: highway-env's `follow_road` and `next_lane`."""

from __future__ import annotations

from typing import NamedTuple

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.layout import LANE, TARGET, X, Y
from dynamics.road_networks.geometry.lanes import NetworkLanes, after_end, distance, local, place
from dynamics.road_networks.geometry.layout import ACROSS, ALONG, COUNT, ID, ROAD, ROUTE, ROUTE_END, TO
from dynamics.road_networks.geometry.network import Network
from dynamics.state import FloatArray, IntArray

__all__ = ["NetworkTraffic", "follow_road", "on_lane_of"]


class NetworkTraffic(NamedTuple):
    """m bodies of one scene on a network.

    Attributes
    ----------
    lanes, network : the road.
    f, g, p : (F, m), (G, m) and (P, m), see `layout`.
    routes : (m, entries, 2): roads, and their lanes or -1.
    bodies : number of bodies present, at most m.
    """

    lanes: NetworkLanes
    network: Network
    f: FloatArray
    g: IntArray
    p: FloatArray
    routes: IntArray
    bodies: int


@kernel_inline
def on_lane_of(traffic: NetworkTraffic, i: int, lane: int) -> tuple[float, float]:
    """(s, r) of a body on a lane [m]; stored values for its own lane."""
    f = traffic.f
    if lane == traffic.g[LANE, i]:
        return f[ALONG, i], f[ACROSS, i]
    return local(traffic.lanes, lane, f[X, i], f[Y, i])


@kernel_no_refcount
def _entered(traffic: NetworkTraffic, lane: int, road: int, wanted: int, x: float, y: float) -> tuple[int, float]:
    """The lane of the next road that follows a lane, and its distance from a point [m]. If both roads have as many
    lanes, it is the lane of the same index, or the `wanted` one (-1 for none); else the closest lane."""
    lanes, roads = traffic.lanes, traffic.network.roads
    first, count = roads[road, 2], roads[road, 3]
    if lanes.ids[lane, COUNT] == count:
        chosen = first + (lanes.ids[lane, ID] if wanted < 0 else wanted)
        return chosen, distance(lanes, chosen, x, y)
    best, least = first, distance(lanes, first, x, y)
    for k in range(1, count):
        away = distance(lanes, first + k, x, y)
        if away < least:
            best, least = first + k, away
    return best, least


@kernel_no_refcount
def _follow_on(traffic: NetworkTraffic, i: int, lane: int, s: float) -> None:
    """`follow_road` for a vehicle at the end of its target lane."""
    lanes, network, g, routes = traffic.lanes, traffic.network, traffic.g, traffic.routes
    node, following, wanted = lanes.ids[lane, TO], -1, -1
    if g[ROUTE, i] < g[ROUTE_END, i]:
        if routes[i, g[ROUTE, i], 0] == lanes.ids[lane, ROAD]:
            g[ROUTE, i] += 1
        if g[ROUTE, i] < g[ROUTE_END, i] and network.roads[routes[i, g[ROUTE, i], 0], 0] == node:
            following, wanted = routes[i, g[ROUTE, i], 0], routes[i, g[ROUTE, i], 1]
    x, y = place(lanes, lane, s)
    if following >= 0:
        g[TARGET, i] = _entered(traffic, lane, following, wanted, x, y)[0]
        return
    best, least = lane, 0.0
    for k in range(network.outs.shape[1]):
        road = network.outs[node, k]
        if road < 0:
            break
        entered, away = _entered(traffic, lane, road, -1, x, y)
        if k == 0 or away < least:
            best, least = entered, away
    g[TARGET, i] = best


@kernel_inline
def follow_road(traffic: NetworkTraffic, i: int) -> None:
    """At the end of a vehicle's target lane, choose the next one: that of its route, or the closest."""
    lane = traffic.g[TARGET, i]
    s = on_lane_of(traffic, i, lane)[0]
    if after_end(traffic.lanes.rows, lane, s):
        _follow_on(traffic, i, lane, s)
