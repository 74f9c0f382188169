"""Observations of the ego on a road network: highway-env's Kinematics and Exit observations."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.arithmetic import clip, dot2, wrap_to_pi
from dynamics.highway_simulator.layout import COS, HEADING, KIND, LANE, LANE_LENGTH, LENGTH, OBSTACLE, SIN, SPEED, X, Y
from dynamics.highway_simulator.random import GeneratorRow, interval
from dynamics.road_networks.geometry.lanes import heading_at, local, place
from dynamics.road_networks.geometry.layout import ACROSS, ALONG, ROUTE, ROUTE_END
from dynamics.road_networks.geometry.routes import NetworkTraffic, on_lane_of
from dynamics.state import FloatArray, IntArray

__all__ = ["AHEAD", "EXIT", "KINEMATICS", "KinematicsWork", "RoadObservationConfig", "kinematics"]

KINEMATICS, EXIT, AHEAD = range(3)
"""Kinds of observation; AHEAD is `TimeToCollision` (see `time_to_collision`)."""
_SIGHT = 200.0
"""`PERCEPTION_DISTANCE` [m]."""
_RELATIVE = 5
"""Features with a lower index than this, except presence, are relative to the ego."""
_TO_GOAL = 8
"""Index of the first of the two features with the direction to the end of the route."""


class RoadObservationConfig(NamedTuple):
    """The configuration of an observation.

    Attributes
    ----------
    kind : KINEMATICS, EXIT or AHEAD.
    features : indices in `dynamics.highway_simulator.observe.FEATURES`.
    ranges : (features, 2), the values mapped to -1 and 1; NaN for features that are not normalised.
    switches : absolute, normalised, clipped, vehicles behind, shuffled, obstacles, sorted, and destinations of the
        others.
    exit_lane : for EXIT, the lane along which the ego's x is measured.
    steps, step : for AHEAD, number of time steps and their duration [s].
    """

    kind: int
    features: IntArray
    ranges: FloatArray
    switches: tuple[bool, bool, bool, bool, bool, bool, bool, bool]
    exit_lane: int
    steps: int
    step: float


@kernel_no_refcount
def _near(
    traffic: NetworkTraffic,
    ego: int,
    most: int,
    switches: tuple[bool, bool, bool, bool, bool, bool, bool, bool],
    near: IntArray,
    away: FloatArray,
) -> int:
    """Up to `most` bodies within sight, by distance along the ego's lane if they are to be sorted.

    Parameters
    ----------
    switches : as of `RoadObservationConfig`.
    near, away : (m,), written: the bodies, and the distance of each along the lane [m].

    Returns
    -------
    The number of bodies.
    """
    f, g, sums = traffic.f, traffic.g, traffic.lanes.sums
    _, _, _, behind, _, obstacles, ordered, _ = switches
    n, lane, back = 0, g[LANE, ego], -2 * traffic.p[LENGTH, ego]
    for i in range(traffic.bodies):
        standing = g[KIND, i] == OBSTACLE
        if i == ego or (standing and not obstacles):
            continue
        dx, dy = f[X, i] - f[X, ego], f[Y, i] - f[Y, ego]
        if not math.sqrt(dot2(sums, dx, dx, dy, dy)) < _SIGHT:
            continue
        along = on_lane_of(traffic, i, lane)[0] - f[ALONG, ego]
        if not ((behind and not standing) or back < along):
            continue
        k = n
        while ordered and k > 0 and abs(along) < away[k - 1]:
            if k < most:
                near[k], away[k] = near[k - 1], away[k - 1]
            k -= 1
        if k < most:
            near[k], away[k] = i, abs(along)
            n = min(n + 1, most)
    return n


@kernel_no_refcount
def _to_goal(traffic: NetworkTraffic, i: int) -> tuple[float, float]:
    """Unit vector from a vehicle to the end of its route; zero without a route."""
    lanes, f, g, routes = traffic.lanes, traffic.f, traffic.g, traffic.routes
    if g[KIND, i] == OBSTACLE or not g[ROUTE, i] < g[ROUTE_END, i]:
        return 0.0, 0.0
    road, own = routes[i, g[ROUTE_END, i] - 1, 0], routes[i, g[ROUTE_END, i] - 1, 1]
    lane = traffic.network.roads[road, 2] + max(own, 0)
    x, y = place(lanes, lane, lanes.rows[lane, LANE_LENGTH])
    dx, dy = x - f[X, i], y - f[Y, i]
    if dx == 0.0 and dy == 0.0:
        return 0.0, 0.0
    away = math.sqrt(dot2(lanes.sums, dx, dx, dy, dy))
    return dx / away, dy / away


@kernel_no_refcount
def _feature(traffic: NetworkTraffic, i: int, feature: int) -> float:
    """A feature of a body, by its index in `FEATURES`."""
    f, g = traffic.f, traffic.g
    standing = g[KIND, i] == OBSTACLE
    if feature == 0:
        return 1.0
    if feature == 1:
        return f[X, i]
    if feature == 2:
        return f[Y, i]
    if feature == 3:
        return 0.0 if standing else f[SPEED, i] * f[COS, i]
    if feature == 4:
        return 0.0 if standing else f[SPEED, i] * f[SIN, i]
    if feature == 6:
        return f[COS, i]
    if feature == 7:
        return f[SIN, i]
    if feature == _TO_GOAL:
        return _to_goal(traffic, i)[0]
    if feature == _TO_GOAL + 1:
        return _to_goal(traffic, i)[1]
    if standing:
        return math.nan
    if feature == 5:
        return f[HEADING, i]
    if feature == 10:
        return f[ALONG, i]
    if feature == 11:
        return f[ACROSS, i]
    return wrap_to_pi(f[HEADING, i] - heading_at(traffic.lanes, g[LANE, i], f[ALONG, i]))


@kernel_inline
def _value(traffic: NetworkTraffic, view: RoadObservationConfig, ego: int, i: int, feature: int) -> float:
    """A feature of a body as observed by the ego."""
    absolute, goals = view.switches[0], view.switches[7]
    if i == ego:
        if view.kind == EXIT and feature == 1:
            return local(traffic.lanes, view.exit_lane, traffic.f[X, ego], traffic.f[Y, ego])[0]
        return _feature(traffic, i, feature)
    if not goals and (feature == _TO_GOAL or feature == _TO_GOAL + 1):
        return 0.0
    value = _feature(traffic, i, feature)
    if not absolute and 1 <= feature < _RELATIVE:
        value -= _feature(traffic, ego, feature)
    return value


class KinematicsWork(NamedTuple):
    """Buffers of `kinematics`, (m,), (m,) and (bodies, features)."""

    near: IntArray
    away: FloatArray
    seen: FloatArray


@kernel_no_refcount
def kinematics(
    row: GeneratorRow,
    traffic: NetworkTraffic,
    view: RoadObservationConfig,
    ego: int,
    work: KinematicsWork,
    out: NDArray[np.float32],
) -> None:
    """Write the ego and the bodies near it, nearest first, to `out`, (bodies, features).

    Parameters
    ----------
    row : the random generator, for a shuffled order.
    """
    near, away, seen = work
    _, normalised, clipped, _, shuffled, _, _, _ = view.switches
    bodies, features, ranges = len(out), view.features, view.ranges
    n = _near(traffic, ego, bodies - 1, view.switches, near, away)
    for k in range(bodies):
        for c in range(len(features)):
            if k > n:
                seen[k, c] = 0.0
                continue
            value = _value(traffic, view, ego, ego if k == 0 else near[k - 1], features[c])
            if normalised and not math.isnan(ranges[c, 0]):
                value = -1 + (value - ranges[c, 0]) * 2 / (ranges[c, 1] - ranges[c, 0])
                if clipped:
                    value = clip(value, -1.0, 1.0)
            seen[k, c] = value
    if shuffled:
        for k in range(bodies - 2, 0, -1):
            j = interval(row, k)
            if j != k:
                for c in range(len(features)):
                    seen[1 + k, c], seen[1 + j, c] = seen[1 + j, c], seen[1 + k, c]
    for k in range(bodies):
        for c in range(len(features)):
            out[k, c] = np.float32(seen[k, c])
