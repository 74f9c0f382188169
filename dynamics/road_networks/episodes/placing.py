"""Initial scene on a road network: vehicles placed by random draws from tables, in highway-env's order of draws.

A scene consists of rows, processed in order. A row places vehicles *at* a position of a lane, *scattered* over roads
with a least distance, or in a *queue*, each ahead of all vehicles present.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.arithmetic import dot2
from dynamics.highway_simulator.layout import (
    CHANGES,
    CHECKS,
    COS,
    DELAY,
    EGO,
    HEADING,
    KIND,
    LANE,
    LANE_LIMIT,
    SIN,
    SPEED,
    TARGET,
    TARGET_SPEED,
    TIMER,
    P,
    X,
    Y,
)
from dynamics.highway_simulator.loops import at
from dynamics.highway_simulator.random import GeneratorRow, below, uniform
from dynamics.highway_simulator.scene import randomize, speed_index
from dynamics.road_networks.episodes.draws import normal
from dynamics.road_networks.episodes.tables import (
    BOUND_FOR,
    DESIRED_SPEED,
    DRAWN,
    EGO_ROW,
    FACING,
    FIRST_LANE,
    GOAL,
    GOALS,
    HEADED,
    LANES,
    MAY_CHANGE,
    NORMAL,
    PLACE,
    PLACE_SPREAD,
    PLACEMENT,
    QUEUE,
    ROLE,
    SCATTERED,
    START_SPEED,
    START_SPEED_SPREAD,
    TRIES,
    UNIFORM,
    VARIES,
    VEHICLES,
)
from dynamics.road_networks.geometry.lanes import closest, heading_at, local, place
from dynamics.road_networks.geometry.layout import ACROSS, ALONG, DYNAMICAL, ID, ROAD, ROUTE, ROUTE_END, TO, F, G
from dynamics.road_networks.geometry.routes import NetworkTraffic
from dynamics.state import FloatArray, IntArray

__all__ = ["ResetTables", "place_row", "place_vehicle", "set_route"]

_COS, _SIN = 3, 4


class ResetTables(NamedTuple):
    """The tables of a reset.

    Attributes
    ----------
    rows, choices : (n, NUMBERS) and (n, INTEGERS), see `tables`.
    constants : (2, P), of the ego and of the traffic. kind : of the traffic, IDM or LINEAR.
    ranges : (6, 2), of the parameters that are drawn (see `dynamics.highway_simulator.kinds.ranges_of`).
    ego : its kind, and whether it has tyre slip.
    target_speeds : of the ego [m/s].
    ways : (nodes, goals, entries), the roads from a node to a goal, -1 after the last.
    roads : (k, 2), the first lane of each road over which vehicles are scattered, and its number of lanes.
    stretches : (lanes, 2), least and greatest s of scattered vehicles on each lane [m].
    apart : least distance between them [m]. along : whether it is measured along the drawn lane, not in a straight
        line.
    odds : (lanes,), cumulative probabilities of the lanes of a queue. packed : factor on the usual spacing of a queue.
    standing, standing_ids, standing_sizes : (F, k), (G, k) and (P, k), the obstacles on the road.
    """

    rows: FloatArray
    choices: IntArray
    constants: FloatArray
    kind: int
    ranges: FloatArray
    ego: tuple[int, int]
    target_speeds: FloatArray
    ways: IntArray
    roads: IntArray
    stretches: FloatArray
    apart: float
    along: bool
    odds: FloatArray
    packed: float
    standing: FloatArray
    standing_ids: IntArray
    standing_sizes: FloatArray


@kernel_inline
def _drawn(row: GeneratorRow, distribution: int, middle: float, spread: float) -> float:
    """A number drawn from the distribution `distribution` (STEADY, UNIFORM or NORMAL) around `middle`."""
    if distribution == UNIFORM:
        return middle + uniform(row, -spread, spread)
    if distribution == NORMAL:
        return middle + normal(row) * spread
    return middle


@kernel_no_refcount
def place_vehicle(
    scene: ResetTables,
    traffic: NetworkTraffic,
    i: int,
    ego: bool,
    pose: tuple[float, float, float],
    speed: float,
) -> None:
    """Place the ego, or a vehicle of the traffic, into column `i`: on the closest lane, which is also its target lane,
    without a route. Its target speed is its speed. `pose` is x, y [m] and the heading [rad]."""
    x, y, heading = pose
    f, g, p, lanes = traffic.f, traffic.g, traffic.p, traffic.lanes
    for k in range(F):
        f[k, i] = 0.0
    for k in range(G):
        g[k, i] = 0
    for k in range(P):
        p[k, i] = scene.constants[0 if ego else 1, k]
    f[X, i], f[Y, i], f[HEADING, i], f[SPEED, i] = x, y, heading, speed
    f[COS, i] = at(lanes.loops[_COS, 0], lanes.loops[_COS, 1], heading)
    f[SIN, i] = at(lanes.loops[_SIN, 0], lanes.loops[_SIN, 1], heading)
    g[LANE, i], f[ALONG, i], f[ACROSS, i] = closest(lanes, x, y, heading, 0)
    g[TARGET, i] = g[LANE, i]
    g[CHECKS, i], g[CHANGES, i], g[ROUTE_END, i] = 1, 1, -1
    if not ego:
        g[KIND, i], f[TARGET_SPEED, i] = scene.kind, speed
        f[TIMER, i] = ((x + y) * math.pi) % p[DELAY, i]
        return
    g[KIND, i], g[DYNAMICAL, i] = scene.ego
    if g[KIND, i] == EGO:
        f[TARGET_SPEED, i] = scene.target_speeds[speed_index(scene.target_speeds, speed)]


@kernel_no_refcount
def set_route(scene: ResetTables, traffic: NetworkTraffic, i: int, goal: int) -> None:
    """Set the route of a vehicle from its lane to a goal."""
    ids, g, routes = traffic.lanes.ids, traffic.g, traffic.routes
    lane, n = g[LANE, i], 1
    routes[i, 0, 0], routes[i, 0, 1] = ids[lane, ROAD], ids[lane, ID]
    for k in range(scene.ways.shape[2]):
        road = scene.ways[ids[lane, TO], goal, k]
        if road < 0:
            break
        routes[i, n, 0], routes[i, n, 1] = road, -1
        n += 1
    g[ROUTE, i], g[ROUTE_END, i] = 0, n


@kernel_no_refcount
def _settle(row: GeneratorRow, scene: ResetTables, traffic: NetworkTraffic, i: int, k: int) -> None:
    """Set the route, parameters, target speed and target lane of a vehicle by row k."""
    f, g, choices = traffic.f, traffic.g, scene.choices[k]
    if choices[GOAL] >= 0 and (choices[ROLE] != EGO_ROW or g[KIND, i] == EGO):
        set_route(scene, traffic, i, choices[GOAL] + below(row, choices[GOALS]))
    if choices[VARIES]:
        randomize(row, scene.kind, scene.ranges, traffic.p, i)
    if not math.isnan(scene.rows[k, DESIRED_SPEED]):
        f[TARGET_SPEED, i] = scene.rows[k, DESIRED_SPEED]
    g[CHANGES, i] = choices[MAY_CHANGE]
    if choices[BOUND_FOR] >= 0:
        g[TARGET, i] = choices[BOUND_FOR]


@kernel_no_refcount
def _at(row: GeneratorRow, scene: ResetTables, traffic: NetworkTraffic, spots: FloatArray, i: int, k: int) -> None:
    """Place a vehicle at the position of row k."""
    numbers, choices, lanes = scene.rows[k], scene.choices[k], traffic.lanes
    lane = choices[FIRST_LANE] + below(row, choices[LANES])
    s = _drawn(row, choices[DRAWN], numbers[PLACE], numbers[PLACE_SPREAD])
    speed = _drawn(row, choices[DRAWN], numbers[START_SPEED], numbers[START_SPEED_SPREAD])
    x, y = place(lanes, lane, s)
    heading = 0.0
    if choices[HEADED]:
        heading = heading_at(lanes, lane, s if math.isnan(numbers[FACING]) else numbers[FACING])
    place_vehicle(scene, traffic, i, choices[ROLE] == EGO_ROW, (x, y, heading), speed)
    spots[0, i], spots[1, i] = lane, s


@kernel_no_refcount
def _free(
    scene: ResetTables,
    traffic: NetworkTraffic,
    spots: FloatArray,
    i: int,
    spot: tuple[int, float],
    here: tuple[float, float],
) -> bool:
    """Whether a position is far enough from those of the first `i` vehicles. It is at `spot`, a lane and s on it [m],
    and at `here`, x and y [m]."""
    f, (lane, s), (x, y) = traffic.f, spot, here
    for j in range(i):
        if scene.along:
            if spots[0, j] == lane and not abs(s - spots[1, j]) > scene.apart:
                return False
            continue
        dx, dy = x - f[X, j], y - f[Y, j]
        if math.sqrt(dot2(traffic.lanes.sums, dx, dx, dy, dy)) < scene.apart:
            return False
    return True


@kernel_no_refcount
def _scattered(
    row: GeneratorRow, scene: ResetTables, traffic: NetworkTraffic, spots: FloatArray, i: int, k: int
) -> bool:
    """Place a vehicle at a random free position by row k, and return whether one was found."""
    numbers, choices, lanes = scene.rows[k], scene.choices[k], traffic.lanes
    for _ in range(choices[TRIES]):
        road = below(row, len(scene.roads))
        lane = scene.roads[road, 0] + below(row, scene.roads[road, 1])
        s = uniform(row, scene.stretches[lane, 0], scene.stretches[lane, 1])
        x, y = place(lanes, lane, s)
        if not _free(scene, traffic, spots, i, (lane, s), (x, y)):
            continue
        speed = _drawn(row, choices[DRAWN], numbers[START_SPEED], numbers[START_SPEED_SPREAD])
        heading = heading_at(lanes, lane, s) if choices[HEADED] else 0.0
        place_vehicle(scene, traffic, i, False, (x, y, heading), speed)
        spots[0, i], spots[1, i] = lane, s
        return True
    return False


@kernel_no_refcount
def _queue(row: GeneratorRow, scene: ResetTables, traffic: NetworkTraffic, i: int, k: int) -> None:
    """Place a vehicle ahead of all others: highway-env's `create_random` on a road of straight lanes."""
    numbers, choices, lanes, f = scene.rows[k], scene.choices[k], traffic.lanes, traffic.f
    lane = choices[FIRST_LANE]
    if choices[LANES] > 1:
        share, drawn = uniform(row, 0.0, 1.0), 0
        while scene.odds[drawn] <= share:
            drawn += 1
        lane += drawn
    speed = lanes.rows[lane, LANE_LIMIT] if math.isnan(numbers[START_SPEED]) else numbers[START_SPEED]
    offset = numbers[PLACE] * (12 + 1.0 * speed) * scene.packed
    s = 3 * offset
    for j in range(i):
        along = local(lanes, lane, f[X, j], f[Y, j])[0]
        s = along if j == 0 else max(s, along)
    s += offset * uniform(row, 0.9, 1.1)
    x, y = place(lanes, lane, s)
    place_vehicle(scene, traffic, i, choices[ROLE] == EGO_ROW, (x, y, heading_at(lanes, lane, s)), speed)


@kernel_no_refcount
def place_row(row: GeneratorRow, scene: ResetTables, traffic: NetworkTraffic, spots: FloatArray, i: int, k: int) -> int:
    """Place the vehicles of row k into the columns from `i` on.

    Parameters
    ----------
    row : the random generator. spots : (2 or more, m), written: the drawn lane of each vehicle, and its s there [m].

    Returns
    -------
    The column after the last vehicle.
    """
    choices = scene.choices[k]
    for _ in range(choices[VEHICLES]):
        if choices[PLACEMENT] == SCATTERED:
            if not _scattered(row, scene, traffic, spots, i, k):
                continue
        elif choices[PLACEMENT] == QUEUE:
            _queue(row, scene, traffic, i, k)
        else:
            _at(row, scene, traffic, spots, i, k)
        _settle(row, scene, traffic, i, k)
        i += 1
    return i
