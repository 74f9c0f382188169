"""The others on a live highway-env's road network, as a certificate sees them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from dynamics.road_networks.geometry.layout import ROAD
from dynamics.road_networks.geometry.network import Network
from dynamics.state import FloatArray, IntArray, Vehicle, readable
from shield.config import ShieldConfig

__all__ = ["Traffic", "default_on", "has_crossings", "read_traffic"]

_PUSHED = 0.5
"""How much wider a wreck is taken than it is: those that crash are pushed apart [m]."""


class Traffic(NamedTuple):
    """The others.

    Attributes
    ----------
    who : what they are, to know them again. rows : vehicle rows, (m, 7). own : the lane that each is on, (m,).
    routes : see `dynamics.road_networks.reachable.prediction.spread`, (m, roads). stand : what stands and the wrecks,
        to know them again. things : rows of these, of wrecks with all of the way that they slide, and of objects with
        that of the coming frame, (b, 7).
    unreadable : bodies left out of all this, with the columns of `Vehicle` that are not readable.
    """

    who: list[Any]
    stand: tuple[Any, ...]
    rows: FloatArray
    own: IntArray
    routes: IntArray
    things: FloatArray
    unreadable: dict[Any, frozenset[Vehicle]]


def has_crossings(base: Any) -> bool:
    """Whether an environment, unwrapped, has a network of several roads."""
    return base.road is not None and sum(map(len, base.road.network.graph.values())) > 1


def default_on(base: Any) -> ShieldConfig:
    """The settings that an environment, unwrapped, gets where none are given: on a network of roads those for its
    traffic."""
    if not has_crossings(base):
        return ShieldConfig()
    hardest = [float(getattr(type(body), "COMFORT_ACC_MAX", 0.0)) for body in base.road.vehicles]
    looks_ahead = bool(getattr(base.road, "neighbour_vehicles_connected_lanes", False))
    return ShieldConfig.for_roads(max([ShieldConfig.for_roads().assumptions.acceleration, *hardest]), looks_ahead)


def _row(body: Any) -> list[float]:
    return [
        *body.position,
        body.heading,
        body.speed,
        body.LENGTH,
        body.WIDTH,
        float(body.crashed),
    ]


def _standing(body: Any, period: float) -> list[float]:
    """Where an object is, with the way that its speed, if it has one, would have it go in the coming frame: highway-env
    counts a collision by that, though objects stay where they are."""
    x, y, heading, speed, length, width, crashed = _row(body)
    way = speed * period
    at = x + 0.5 * way * np.cos(heading), y + 0.5 * way * np.sin(heading)
    return [*at, heading, 0.0, length + abs(way), width, crashed]


def _sliding(body: Any) -> list[float]:
    """Where a wreck may slide to: it does not steer, and brakes at -1 * speed per second."""
    x, y, heading, speed, length, width, crashed = _row(body)
    way = 0.5 * speed
    at = x + way * np.cos(heading), y + way * np.sin(heading)
    return [*at, heading, 0.0, length + abs(speed), width + _PUSHED, crashed]


def _lane_of(body: Any, network: Any, lanes: Mapping[tuple[str, str, int], int]) -> tuple[str, str, int]:
    """The lane that a vehicle is on: the one that it names, where it is there, or else highway-env's closest: a vehicle
    that is placed by hand may name one that it has left."""
    start, end, lane = body.lane_index or (None, None, None)
    named: Any = (start, end, lane or 0)
    if named in lanes and network.get_lane(named).on_lane(body.position):
        found: tuple[str, str, int] = named
        return found
    start, end, lane = network.get_closest_lane_index(body.position, body.heading)
    return start, end, lane


def read_traffic(base: Any, network: Network, lanes: Mapping[tuple[str, str, int], int]) -> Traffic:
    """Read the simulator's state of an environment, unwrapped."""
    bodies = [body for body in (*base.road.vehicles, *base.road.objects) if body is not base.vehicle]
    read = readable(np.array([_row(body) for body in bodies], float).reshape(-1, len(Vehicle)))
    unreadable = {
        body: frozenset(map(Vehicle, np.flatnonzero(~row).tolist()))
        for body, row in zip(bodies, read, strict=True)
        if not row.all()
    }
    others = [body for body in base.road.vehicles if body is not base.vehicle and body not in unreadable]
    who = [body for body in others if not body.crashed]
    rows = np.array([_row(body) for body in who], float).reshape(-1, len(Vehicle))
    objects = [body for body in base.road.objects if body not in unreadable]
    wrecks = [body for body in others if body.crashed]
    period = 1 / base.config["simulation_frequency"]
    standing = [*(_standing(body, period) for body in objects), *map(_sliding, wrecks)]
    things = np.array(standing, float).reshape(-1, len(Vehicle))
    own, routes = np.zeros(len(who), np.int64), np.zeros((len(who), len(network.roads)), np.int64)
    for i, body in enumerate(who):
        key = _lane_of(body, base.road.network, lanes)
        own[i] = lanes[key]
        route = getattr(body, "route", None) or []
        for k, (a, b, _) in enumerate(route):
            routes[i, network.ids[lanes[a, b, 0], ROAD]] = 2 if k == len(route) - 1 else 1
        if route and route[0][0] == key[1]:
            # highway-env forgets the road that a vehicle is on a little before its end.
            routes[i, network.ids[own[i], ROAD]] = 1
    return Traffic(who, (*objects, *wrecks), rows, own, routes, things, unreadable)
