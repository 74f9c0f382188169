"""Reads the other vehicles and objects of a live highway-env road network."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from dynamics.road_networks.geometry.layout import ROAD
from dynamics.road_networks.geometry.network import Network
from dynamics.state import FloatArray, IntArray, Vehicle, readable
from shield.config import ShieldConfig

__all__ = ["TrafficRows", "default_on", "has_crossings", "read_traffic"]

_WRECK_WIDENING = 0.5
"""Width added to a wreck [m], since highway-env pushes crashed vehicles apart."""


class TrafficRows(NamedTuple):
    """The other vehicles and objects, for m vehicles and b standing bodies.

    Attributes
    ----------
    identities : the simulator's vehicle objects, which identify them, (m,).
    stand : standing bodies: the objects, then the wrecks, (b,).
    rows : vehicle rows, (m, 7). own : index of each vehicle's lane, (m,).
    routes : (m, roads), see `dynamics.road_networks.reachable.prediction.add_all_strips`.
    things : rows of the standing bodies, (b, 7). A wreck is extended by its whole sliding distance, an object by the
        distance of the coming frame.
    unreadable : bodies left out of the arrays, with the columns of `Vehicle` that are not readable.
    """

    identities: list[Any]
    stand: tuple[Any, ...]
    rows: FloatArray
    own: IntArray
    routes: IntArray
    things: FloatArray
    unreadable: dict[Any, frozenset[Vehicle]]


def has_crossings(base: Any) -> bool:
    """Whether an unwrapped environment has a network of several roads."""
    return base.road is not None and sum(map(len, base.road.network.graph.values())) > 1


def default_on(base: Any) -> ShieldConfig:
    """Default settings for an unwrapped environment; on a network of several roads, those for its traffic."""
    if not has_crossings(base):
        return ShieldConfig()
    hardest = [float(getattr(type(body), "COMFORT_ACC_MAX", 0.0)) for body in base.road.vehicles]
    looks_ahead = bool(getattr(base.road, "neighbour_vehicles_connected_lanes", False))
    return ShieldConfig.for_roads(max([ShieldConfig.for_roads().assumptions.acceleration, *hardest]), looks_ahead)


def _row(body: Any) -> list[float]:
    """Row of a body, with the columns of `Vehicle`."""
    return [
        *body.position,
        body.heading,
        body.speed,
        body.LENGTH,
        body.WIDTH,
        float(body.crashed),
    ]


def _standing(body: Any, period: float) -> list[float]:
    """Row of an object, extended by the distance that its speed would take it in the coming frame. highway-env counts
    collisions by that distance, though objects do not move. `period` is the frame [s]."""
    x, y, heading, speed, length, width, crashed = _row(body)
    way = speed * period
    at = x + 0.5 * way * np.cos(heading), y + 0.5 * way * np.sin(heading)
    return [*at, heading, 0.0, length + abs(way), width, crashed]


def _sliding(body: Any) -> list[float]:
    """Row of a wreck, extended by its sliding distance: a wreck does not steer, and decelerates at its speed per
    second."""
    x, y, heading, speed, length, width, crashed = _row(body)
    way = 0.5 * speed
    at = x + way * np.cos(heading), y + way * np.sin(heading)
    return [*at, heading, 0.0, length + abs(speed), width + _WRECK_WIDENING, crashed]


def _lane_of(body: Any, network: Any, lanes: Mapping[tuple[str, str, int], int]) -> tuple[str, str, int]:
    """Lane of a vehicle: the one that it names, if it is on it, otherwise the one closest to it by highway-env. A
    vehicle placed by hand may name a lane that it has left."""
    start, end, lane = body.lane_index or (None, None, None)
    named: Any = (start, end, lane or 0)
    if named in lanes and network.get_lane(named).on_lane(body.position):
        found: tuple[str, str, int] = named
        return found
    start, end, lane = network.get_closest_lane_index(body.position, body.heading)
    return start, end, lane


def _route_of(body: Any, lanes: Mapping[tuple[str, str, int], int]) -> list[Any]:
    """The route of a vehicle; none, so that it may take every way, if the route names a road that does not exist."""
    route = getattr(body, "route", None) or []
    try:
        known = all((start, end, 0) in lanes for start, end, _ in route)
    except (TypeError, ValueError):
        return []
    return list(route) if known else []


def read_traffic(base: Any, network: Network, lanes: Mapping[tuple[str, str, int], int]) -> TrafficRows:
    """Read the simulator's state of an unwrapped environment.

    Parameters
    ----------
    network : the environment's roads, as arrays. lanes : index of each highway-env lane.
    """
    bodies = [body for body in (*base.road.vehicles, *base.road.objects) if body is not base.vehicle]
    read = readable(np.array([_row(body) for body in bodies], float).reshape(-1, len(Vehicle)))
    unreadable = {
        body: frozenset(map(Vehicle, np.flatnonzero(~row).tolist()))
        for body, row in zip(bodies, read, strict=True)
        if not row.all()
    }
    others = [body for body in base.road.vehicles if body is not base.vehicle and body not in unreadable]
    identities = [body for body in others if not body.crashed]
    rows = np.array([_row(body) for body in identities], float).reshape(-1, len(Vehicle))
    objects = [body for body in base.road.objects if body not in unreadable]
    wrecks = [body for body in others if body.crashed]
    period = 1 / base.config["simulation_frequency"]
    standing = [*(_standing(body, period) for body in objects), *map(_sliding, wrecks)]
    things = np.array(standing, float).reshape(-1, len(Vehicle))
    own, routes = np.zeros(len(identities), np.int64), np.zeros((len(identities), len(network.roads)), np.int64)
    for i, body in enumerate(identities):
        key = _lane_of(body, base.road.network, lanes)
        own[i] = lanes[key]
        route = _route_of(body, lanes)
        for k, (a, b, _) in enumerate(route):
            routes[i, network.ids[lanes[a, b, 0], ROAD]] = 2 if k == len(route) - 1 else 1
        if route and route[0][0] == key[1]:
            # highway-env drops a road from the route a little before its end.
            routes[i, network.ids[own[i], ROAD]] = 1
    return TrafficRows(identities, (*objects, *wrecks), rows, own, routes, things, unreadable)
