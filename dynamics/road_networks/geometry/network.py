"""A road network of highway-env as arrays: its lanes and their connections."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from highway_env.road.lane import CircularLane, SineLane, StraightLane

from dynamics.errors import SceneError
from dynamics.highway_simulator.layout import LANE_LENGTH, LANE_LIMIT, LANE_WIDTH
from dynamics.road_networks.geometry.layout import (
    ACROSS_X,
    ALONG_X,
    AMPLITUDE,
    CIRCULAR,
    COLUMNS,
    COUNT,
    CROSSES,
    DIRECTION,
    ENDS,
    FIRST,
    FORBIDDEN,
    ID,
    IDS,
    LANE_HEADING,
    LEADS_BACK,
    LEAST_X,
    LEAVES,
    MOST_X,
    ORIGIN_X,
    PHASE,
    PRIORITY,
    PULSATION,
    QUARTER,
    RADIUS,
    REACH,
    ROAD,
    SHAPE,
    SINE,
    STRAIGHT,
    TO,
)
from dynamics.state import FloatArray, IntArray

__all__ = ["Network", "has_crossing_ways", "index_of", "network_of"]

Leaves = Callable[[tuple[str, str, int]], bool]
_SHAPES = {StraightLane: STRAIGHT, SineLane: SINE, CircularLane: CIRCULAR}
_SLACK = 1e-6
"""Margin of the boxes around lanes, for rounding [m]."""


class Network(NamedTuple):
    """n lanes, in highway-env's order, grouped into roads, which lead from node to node.

    Attributes
    ----------
    lanes : (n, COLUMNS) float64, see `layout`. ids : (n, IDS) integers.
    roads : start node, end node, first lane and number of lanes of each road, (roads, 4).
    outs : the roads that leave each node, in highway-env's order, (nodes, most); -1 for none.
    linked : further lanes on which the neighbours of a vehicle are searched, (n, most, 2): the lane, -1 for none, and 1
        if it follows, -1 if it precedes. No columns if highway-env searches one lane at a time.
    near : for each lane, the lanes with boxes within 2 `REACH` of its own, including itself, in order, (n, most);
        -1 for none.
    """

    lanes: FloatArray
    ids: IntArray
    roads: IntArray
    outs: IntArray
    linked: IntArray
    near: IntArray


def index_of(network: Any) -> dict[tuple[str, str, int], int]:
    """The number of each lane, by highway-env's index of it."""
    return {key: number for number, key in enumerate(network.lanes_dict())}


def network_of(network: Any, connected: bool = False, leaves: Leaves | None = None) -> Network:
    """Read a `RoadNetwork`.

    Parameters
    ----------
    network : highway-env's `RoadNetwork`.
    connected : whether neighbours are searched on the lanes before and after a lane too.
    leaves : whether vehicles vanish near the end of a lane, by highway-env's index of it; by default they do not.

    Raises
    ------
    SceneError
        If a lane is neither straight nor a sine nor an arc.
    """
    graph, numbers = network.graph, index_of(network)
    strange = sorted({type(lane).__name__ for lane in network.lanes_list() if type(lane) not in _SHAPES})
    if strange:
        known = ", ".join(kind.__name__ for kind in _SHAPES)
        raise SceneError(f"the compiled network has {known}, not {', '.join(strange)}")
    nodes = {name: k for k, name in enumerate(dict.fromkeys([*graph, *(to for outs in graph.values() for to in outs)]))}
    edges = {(a, b): k for k, (a, b) in enumerate((a, b) for a, outs in graph.items() for b in outs)}
    lanes, ids = np.zeros((len(numbers), COLUMNS)), np.zeros((len(numbers), IDS), np.int64)
    roads = np.zeros((len(edges), 4), np.int64)
    for (a, b), edge in edges.items():
        roads[edge] = nodes[a], nodes[b], numbers[a, b, 0], len(graph[a][b])
        for k, lane in enumerate(graph[a][b]):
            n = numbers[a, b, k]
            lanes[n] = _numbers(lane)
            ids[n, [ROAD, ID, COUNT, FIRST, TO]] = edge, k, len(graph[a][b]), numbers[a, b, 0], nodes[b]
            ids[n, [SHAPE, FORBIDDEN, PRIORITY]] = _SHAPES[type(lane)], bool(lane.forbidden), lane.priority
            ids[n, LEAVES] = leaves is not None and leaves((a, b, k))
            ids[n, CROSSES] = _crosses(graph, a, b)
            if all(_leads_back(lane, each) for each in graph.get(b, {}).values()):
                ids[n, ENDS] = LEADS_BACK if graph.get(b) else 1
    outs = [[edges[name, to] for to in graph.get(name, {})] for name in nodes]
    linked = [_linked(graph, numbers, key) if connected else [] for key in numbers]
    return Network(lanes, ids, roads, _table(outs), _pairs(linked), _near(lanes))


def has_crossing_ways(network: Any) -> bool:
    """Whether ways cross on a `RoadNetwork`: whether a lane leads from a node where roads part to a node where roads
    join.

    Intersections and roundabouts have such lanes; merges, exits, two-way roads and u-turns have none.
    """
    return any(_crosses(network.graph, a, b) for a, outs in network.graph.items() for b in outs)


def _crosses(graph: Any, a: str, b: str) -> bool:
    """Whether the road from node a to node b leads from a node where roads part to a node where roads join."""
    return len(graph[a]) > 1 and sum(b in outs for outs in graph.values()) > 1


def _leads_back(lane: Any, road: list[Any]) -> bool:
    """Whether a road that begins at the end of a lane leads in the opposite direction."""
    return bool(np.cos(road[0].heading_at(0.0) - lane.heading_at(lane.length)) < 0)


def _table(rows: list[list[int]]) -> IntArray:
    """Rows of different lengths as an array, filled with -1."""
    out = np.full((len(rows), max(map(len, rows), default=0)), -1, np.int64)
    for k, row in enumerate(rows):
        out[k, : len(row)] = row
    return out


def _near(lanes: FloatArray) -> IntArray:
    """The table `Network.near`."""
    low, high = lanes[:, LEAST_X : LEAST_X + 2] - REACH, lanes[:, MOST_X : MOST_X + 2] + REACH
    x, y = ((low[:, None, axis] <= high[:, axis]) & (low[:, axis] <= high[:, None, axis]) for axis in range(2))
    return _table([np.flatnonzero(row).tolist() for row in x & y])


def _pairs(rows: list[list[tuple[int, int]]]) -> IntArray:
    """Rows of pairs as an array, filled with -1."""
    out = np.full((len(rows), max(map(len, rows), default=0), 2), -1, np.int64)
    for k, row in enumerate(rows):
        for j, pair in enumerate(row):
            out[k, j] = pair
    return out


def _linked(graph: Any, numbers: dict[tuple[str, str, int], int], key: tuple[str, str, int]) -> list[tuple[int, int]]:
    """The further lanes that highway-env's `neighbour_vehicles` searches: one of each road after a lane and before
    it."""
    start, end, k = key
    after = [(end, to, len(lanes)) for to, lanes in graph.get(end, {}).items()]
    before = [(name, start, len(outs[start])) for name, outs in graph.items() if start in outs]
    found = []
    for roads, sign in ((after, 1), (before, -1)):
        found += [(numbers[a, b, k if k < count else 0], sign) for a, b, count in roads if count]
    return found


def _numbers(lane: Any) -> FloatArray:
    """A row of `Network.lanes`."""
    row = np.zeros(COLUMNS)
    row[[LANE_WIDTH, LANE_LENGTH]] = lane.width, lane.length
    row[LANE_LIMIT] = math.inf if lane.speed_limit is None else lane.speed_limit
    outline = _outline(lane)
    row[LEAST_X : LEAST_X + 2], row[MOST_X : MOST_X + 2] = outline.min(0) - _SLACK, outline.max(0) + _SLACK
    if isinstance(lane, CircularLane):
        row[ORIGIN_X : ORIGIN_X + 2] = lane.center
        row[[PHASE, RADIUS, DIRECTION]] = lane.start_phase, lane.radius, lane.direction
        row[QUARTER] = np.pi / 2 * lane.direction
        return row
    row[LANE_HEADING] = lane.heading
    row[ORIGIN_X : ORIGIN_X + 2] = lane.start
    row[ALONG_X : ALONG_X + 2], row[ACROSS_X : ACROSS_X + 2] = lane.direction, lane.direction_lateral
    if isinstance(lane, SineLane):
        row[[AMPLITUDE, PULSATION, PHASE]] = lane.amplitude, lane.pulsation, lane.phase
    return row


def _outline(lane: Any) -> FloatArray:
    """Points around a lane; their bounding box contains its centre line, (k, 2) [m]."""
    if isinstance(lane, CircularLane):
        turned = lane.direction * lane.length / lane.radius
        first, last = sorted((lane.start_phase, lane.start_phase + turned))
        quarters = np.pi / 2 * np.arange(np.ceil(first / (np.pi / 2)), np.floor(last / (np.pi / 2)) + 1)
        angles = np.array([first, last, *quarters])
        points: FloatArray = np.asarray(lane.center) + lane.radius * np.column_stack([np.cos(angles), np.sin(angles)])
        return points
    wide = abs(lane.amplitude) if isinstance(lane, SineLane) else 0.0
    start, along, across = (np.asarray(each) for each in (lane.start, lane.direction, lane.direction_lateral))
    return np.array([start + s * along + r * across for s in (0.0, lane.length) for r in (-wide, wide)])
