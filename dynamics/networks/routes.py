"""Which lane comes next: highway-env's `follow_road` and `next_lane`."""

from __future__ import annotations

from dynamics.compiled import uncounted
from dynamics.networks.lanes import after_end, distance, local, place
from dynamics.networks.layout import ALONG, COUNT, ID, ROAD, ROUTE, ROUTE_END, TO
from dynamics.networks.network import Network
from dynamics.simulator.layout import LANE, TARGET, X, Y
from dynamics.state import FloatArray, IntArray

__all__ = ["follow_road"]


@uncounted
def _entered(
    sums: int, loops: IntArray, network: Network, lane: int, road: int, wanted: int, x: float, y: float
) -> tuple[int, float]:
    """The lane of the next road that follows a lane, and how far it is from a place [m]: the same of as many, the one
    that is `wanted` (-1 for none), or the closest."""
    lanes, ids, roads = network.lanes, network.ids, network.roads
    first, count = roads[road, 2], roads[road, 3]
    if ids[lane, COUNT] == count:
        chosen = first + (ids[lane, ID] if wanted < 0 else wanted)
        return chosen, distance(sums, loops, lanes, ids, chosen, x, y)
    best, least = first, distance(sums, loops, lanes, ids, first, x, y)
    for k in range(1, count):
        away = distance(sums, loops, lanes, ids, first + k, x, y)
        if away < least:
            best, least = first + k, away
    return best, least


@uncounted
def follow_road(
    sums: int, loops: IntArray, network: Network, f: FloatArray, g: IntArray, routes: IntArray, i: int
) -> None:
    """At the end of the lane that a vehicle is bound for, the next one: of its route, or the closest.

    Parameters
    ----------
    routes : (m, entries, 2): roads, and their lanes or -1.
    """
    lanes, ids, lane = network.lanes, network.ids, g[TARGET, i]
    s = f[ALONG, i] if lane == g[LANE, i] else local(sums, loops, lanes, ids, lane, f[X, i], f[Y, i])[0]
    if not after_end(lanes, lane, s):
        return
    node, following, wanted = ids[lane, TO], -1, -1
    if g[ROUTE, i] < g[ROUTE_END, i]:
        if routes[i, g[ROUTE, i], 0] == ids[lane, ROAD]:
            g[ROUTE, i] += 1
        if g[ROUTE, i] < g[ROUTE_END, i] and network.roads[routes[i, g[ROUTE, i], 0], 0] == node:
            following, wanted = routes[i, g[ROUTE, i], 0], routes[i, g[ROUTE, i], 1]
    x, y = place(loops, lanes, ids, lane, s)
    if following >= 0:
        g[TARGET, i] = _entered(sums, loops, network, lane, following, wanted, x, y)[0]
        return
    best, least = lane, 0.0
    for k in range(network.outs.shape[1]):
        road = network.outs[node, k]
        if road < 0:
            break
        entered, away = _entered(sums, loops, network, lane, road, -1, x, y)
        if k == 0 or away < least:
            best, least = entered, away
    g[TARGET, i] = best
