"""Initial scene on a road network: vehicles placed by random draws from tables, in highway-env's order of draws.

A scene consists of rows, processed in order. A row places vehicles *at* a position of a lane, *scattered* over roads
with a least distance, or in a *queue*, each ahead of all vehicles present.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from dynamics.compiled import inlined, uncounted
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
from dynamics.highway_simulator.random import Row, below, uniform
from dynamics.highway_simulator.scene import randomize, speed_index
from dynamics.road_networks.episodes.draws import normal
from dynamics.road_networks.episodes.tables import (
    BOUND_FOR,
    DRAWN,
    EGO_ROW,
    FACING,
    FAST,
    FAST_SPREAD,
    FIRST_LANE,
    GOAL,
    GOALS,
    HEADED,
    LANES,
    LAW,
    MANY,
    MAY_CHANGE,
    NORMAL,
    PLACE,
    PLACE_SPREAD,
    QUEUE,
    SCATTERED,
    TRIES,
    UNIFORM,
    VARIES,
    WANTED,
    WHOSE,
)
from dynamics.road_networks.geometry.lanes import closest, heading_at, local, place
from dynamics.road_networks.geometry.layout import ACROSS, ALONG, DYNAMICAL, ID, ROAD, ROUTE, ROUTE_END, TO, F, G
from dynamics.road_networks.geometry.routes import Traffic
from dynamics.state import FloatArray, IntArray

__all__ = ["Scene", "plan", "put", "put_row"]

_COS, _SIN = 3, 4


class Scene(NamedTuple):
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


@inlined
def _drawn(row: Row, law: int, middle: float, spread: float) -> float:
    """A number drawn from the distribution `law` (STEADY, UNIFORM or NORMAL) around `middle`."""
    if law == UNIFORM:
        return middle + uniform(row, -spread, spread)
    if law == NORMAL:
        return middle + normal(row) * spread
    return middle


@uncounted
def put(scene: Scene, traffic: Traffic, i: int, ego: bool, x: float, y: float, heading: float, speed: float) -> None:
    """Place the ego, or a vehicle of the traffic, into column `i`: on the closest lane, which is also its target lane,
    without a route. Its target speed is its speed."""
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


@uncounted
def plan(scene: Scene, traffic: Traffic, i: int, goal: int) -> None:
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


@uncounted
def _settle(row: Row, scene: Scene, traffic: Traffic, i: int, k: int) -> None:
    """Set the route, parameters, target speed and target lane of a vehicle by row k."""
    f, g, choices = traffic.f, traffic.g, scene.choices[k]
    if choices[GOAL] >= 0 and (choices[WHOSE] != EGO_ROW or g[KIND, i] == EGO):
        plan(scene, traffic, i, choices[GOAL] + below(row, choices[GOALS]))
    if choices[VARIES]:
        randomize(row, scene.kind, scene.ranges, traffic.p, i)
    if not math.isnan(scene.rows[k, WANTED]):
        f[TARGET_SPEED, i] = scene.rows[k, WANTED]
    g[CHANGES, i] = choices[MAY_CHANGE]
    if choices[BOUND_FOR] >= 0:
        g[TARGET, i] = choices[BOUND_FOR]


@uncounted
def _at(row: Row, scene: Scene, traffic: Traffic, spots: FloatArray, i: int, k: int) -> None:
    """Place a vehicle at the position of row k."""
    numbers, choices, lanes = scene.rows[k], scene.choices[k], traffic.lanes
    lane = choices[FIRST_LANE] + below(row, choices[LANES])
    s = _drawn(row, choices[DRAWN], numbers[PLACE], numbers[PLACE_SPREAD])
    speed = _drawn(row, choices[DRAWN], numbers[FAST], numbers[FAST_SPREAD])
    x, y = place(lanes, lane, s)
    heading = 0.0
    if choices[HEADED]:
        heading = heading_at(lanes, lane, s if math.isnan(numbers[FACING]) else numbers[FACING])
    put(scene, traffic, i, choices[WHOSE] == EGO_ROW, x, y, heading, speed)
    spots[0, i], spots[1, i] = lane, s


@uncounted
def _free(scene: Scene, traffic: Traffic, spots: FloatArray, i: int, lane: int, s: float, x: float, y: float) -> bool:
    """Whether a position is far enough from those of the first `i` vehicles."""
    f = traffic.f
    for j in range(i):
        if scene.along:
            if spots[0, j] == lane and not abs(s - spots[1, j]) > scene.apart:
                return False
            continue
        dx, dy = x - f[X, j], y - f[Y, j]
        if math.sqrt(dot2(traffic.lanes.sums, dx, dx, dy, dy)) < scene.apart:
            return False
    return True


@uncounted
def _scattered(row: Row, scene: Scene, traffic: Traffic, spots: FloatArray, i: int, k: int) -> bool:
    """Place a vehicle at a random free position by row k, and return whether one was found."""
    numbers, choices, lanes = scene.rows[k], scene.choices[k], traffic.lanes
    for _ in range(choices[TRIES]):
        road = below(row, len(scene.roads))
        lane = scene.roads[road, 0] + below(row, scene.roads[road, 1])
        s = uniform(row, scene.stretches[lane, 0], scene.stretches[lane, 1])
        x, y = place(lanes, lane, s)
        if not _free(scene, traffic, spots, i, lane, s, x, y):
            continue
        speed = _drawn(row, choices[DRAWN], numbers[FAST], numbers[FAST_SPREAD])
        heading = heading_at(lanes, lane, s) if choices[HEADED] else 0.0
        put(scene, traffic, i, False, x, y, heading, speed)
        spots[0, i], spots[1, i] = lane, s
        return True
    return False


@uncounted
def _queue(row: Row, scene: Scene, traffic: Traffic, i: int, k: int) -> None:
    """Place a vehicle ahead of all others: highway-env's `create_random` on a road of straight lanes."""
    numbers, choices, lanes, f = scene.rows[k], scene.choices[k], traffic.lanes, traffic.f
    lane = choices[FIRST_LANE]
    if choices[LANES] > 1:
        share, drawn = uniform(row, 0.0, 1.0), 0
        while scene.odds[drawn] <= share:
            drawn += 1
        lane += drawn
    speed = lanes.rows[lane, LANE_LIMIT] if math.isnan(numbers[FAST]) else numbers[FAST]
    offset = numbers[PLACE] * (12 + 1.0 * speed) * scene.packed
    s = 3 * offset
    for j in range(i):
        along = local(lanes, lane, f[X, j], f[Y, j])[0]
        s = along if j == 0 else max(s, along)
    s += offset * uniform(row, 0.9, 1.1)
    x, y = place(lanes, lane, s)
    put(scene, traffic, i, choices[WHOSE] == EGO_ROW, x, y, heading_at(lanes, lane, s), speed)


@uncounted
def put_row(row: Row, scene: Scene, traffic: Traffic, spots: FloatArray, i: int, k: int) -> int:
    """Place the vehicles of row k into the columns from `i` on.

    Parameters
    ----------
    row : the random generator. spots : (2 or more, m), written: the drawn lane of each vehicle, and its s there [m].

    Returns
    -------
    The column after the last vehicle.
    """
    choices = scene.choices[k]
    for _ in range(choices[MANY]):
        if choices[LAW] == SCATTERED:
            if not _scattered(row, scene, traffic, spots, i, k):
                continue
        elif choices[LAW] == QUEUE:
            _queue(row, scene, traffic, i, k)
        else:
            _at(row, scene, traffic, spots, i, k)
        _settle(row, scene, traffic, i, k)
        i += 1
    return i
