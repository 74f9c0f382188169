"""The others on a live highway-env's road network, as a certificate sees them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from dynamics.networks.layout import ROAD
from dynamics.networks.network import Network
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
    routes : see `dynamics.networks.reachable.prediction.spread`, (m, roads). stand : what stands and the wrecks, to
        know them again. things : rows of these, of wrecks with all of the way that they slide, (b, 7).
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


def _sliding(body: Any) -> list[float]:
    """Where a wreck may slide to: it does not steer, and brakes at -1 * speed per second."""
    x, y, heading, speed, length, width, crashed = _row(body)
    way = 0.5 * speed
    at = x + way * np.cos(heading), y + way * np.sin(heading)
    return [*at, heading, 0.0, length + abs(speed), width + _PUSHED, crashed]


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
    standing = [*map(_row, objects), *map(_sliding, wrecks)]
    things = np.array(standing, float).reshape(-1, len(Vehicle))
    own, routes = np.zeros(len(who), np.int64), np.zeros((len(who), len(network.roads)), np.int64)
    for i, body in enumerate(who):
        start, end, lane = body.lane_index
        own[i] = lanes[start, end, lane or 0]
        route = getattr(body, "route", None) or []
        for k, (a, b, _) in enumerate(route):
            routes[i, network.ids[lanes[a, b, 0], ROAD]] = 2 if k == len(route) - 1 else 1
        if route and route[0][0] == end:
            # highway-env forgets the road that a vehicle is on a little before its end.
            routes[i, network.ids[own[i], ROAD]] = 1
    return Traffic(who, (*objects, *wrecks), rows, own, routes, things, unreadable)
