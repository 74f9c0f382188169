"""Lanes that follow each lane: all that a road network offers, independent of a vehicle's route."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.vehicle.kinematics import Vehicle

from dynamics.road_networks.geometry.network import index_of
from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.vehicle.bicycle import WIDTH

__all__ = [
    "RECENTRED_DISTANCE",
    "TURNING",
    "TURN_IN_DISTANCE",
    "bends_before_of",
    "continuations_of",
    "leads_off_of",
    "leads_over",
    "overruns_of",
]

RECENTRED_DISTANCE = 25.0
"""Distance after which a vehicle that has entered a lane from beside it is back at the centre of the lane [m]."""
TURN_IN_DISTANCE = 3.0
"""Distance from the joint of two lanes within which a vehicle turns from one into the other [m]: before the joint, or
behind it where the joint has a sharp bend."""
TURNING = 0.9
"""Greatest deviation of a vehicle's heading from a lane that it is entering [rad]."""
_BESIDE_CENTRE = 0.2
"""Deviation of a vehicle from the centre of a lane [m]."""
_SLACK, _STRAIGHT, _BESIDE, _PASSES = 1.0, 0.1, 0.3, 3
_TOUCH = 2.5
"""A lane that begins within this distance of the end of another continues it [m]. If no lane of a road does, the
nearest one continues it."""


def continuations_of(network: Any) -> tuple[IntArray, FloatArray, FloatArray]:
    """The lanes that follow each lane of a `RoadNetwork`.

    Lanes are numbered as by `dynamics.road_networks.geometry.network.index_of`. A road that begins at the end of a lane
    and leads back in the opposite direction does not continue it.

    Returns
    -------
    after : the lanes that follow each lane, (n, most), -1 for none.
    ends : s and r on the following lane at which the lane ends, and the additional room where the joint is not
        smooth, (n, most, 3) [m].
    entries : least s, least r and greatest r at which vehicles enter each lane, (n, 3) [m].
    """
    graph, numbers = network.graph, index_of(network)
    found: list[list[tuple[int, tuple[float, float, float]]]] = []
    for a, b, k in numbers:
        lane = graph[a][b][k]
        end, heading = lane.position(lane.length, 0.0), lane.heading_at(lane.length)
        after: list[tuple[int, tuple[float, float, float]]] = []
        for to, road in graph.get(b, {}).items():
            ahead = [j for j, each in enumerate(road) if np.cos(each.heading_at(0.0) - heading) > 0]
            if not ahead:
                continue
            away = {j: float(np.hypot(*(road[j].position(0.0, 0.0) - end))) for j in ahead}
            near = [j for j in ahead if away[j] <= _TOUCH] or [min(ahead, key=away.__getitem__)]
            after += [(numbers[b, to, j], _joint(road[j], end, heading)) for j in near]
        found.append(after)
    table = np.full((len(found), max(map(len, found), default=0)), -1, np.int64)
    ends = np.zeros((*table.shape, 3))
    for k, after in enumerate(found):
        for j, (lane, place) in enumerate(after):
            table[k, j], ends[k, j] = lane, place
    return table, ends, _entries(table, ends, np.array([lane.length for lane in network.lanes_list()]))


def _joint(lane: Any, end: FloatArray, heading: float) -> tuple[float, float, float]:
    """s and r on a lane at which another lane ends, and the additional room where the joint is not smooth [m]."""
    s, r = lane.local_coordinates(end)
    smooth = abs(r) < _BESIDE and abs(np.sin(heading - lane.heading_at(min(max(s, 0.0), lane.length)))) < _STRAIGHT
    return float(s), float(r), 0.0 if smooth else _SLACK


def leads_over(network: Any) -> IntArray:
    """For each lane that ends, the neighbouring lane that a vehicle has to change to, (n,); -1 for other lanes."""
    graph, numbers = network.graph, index_of(network)
    over = np.full(len(numbers), -1, np.int64)
    for (a, b, k), number in numbers.items():
        lane = graph[a][b][k]
        end, heading = lane.position(lane.length, 0.0), lane.heading_at(lane.length)
        roads = [road for road in graph.get(b, {}).values() if np.cos(road[0].heading_at(0.0) - heading) > 0]
        offsets = [each.local_coordinates(end)[1] for road in roads for each in road]
        if not offsets or min(map(abs, offsets)) <= lane.width / 2:
            continue
        side = -1 if min(offsets, key=abs) > 0 else 1
        if 0 <= k + side < len(graph[a][b]):
            over[number] = numbers[a, b, k + side]
    return over


def overruns_of(network: Any, after: IntArray, entries: FloatArray) -> FloatArray:
    """How far a vehicle may drive straight on past the end of each lane [m], (n,), before it has turned into the next.

    It is `TURN_IN_DISTANCE` where the joint with each next lane has so sharp a bend that a vehicle on the straight does
    not count as entering that lane, otherwise 0. `after` and `entries` as from `continuations_of`.
    """
    lanes, overruns = network.lanes_list(), np.zeros(len(after))
    for k, row in enumerate(after):
        following = row[row >= 0]
        if len(following) and not any(_takes_in(lanes[k], lanes[j], entries[j]) for j in following):
            overruns[k] = TURN_IN_DISTANCE
    return overruns


def leads_off_of(network: Any, after: IntArray, distance: float) -> BoolArray:
    """Whether straight motion past the end of each lane leads off all lanes that follow, within `distance` [m], (n,).
    `after` as from `continuations_of`.

    highway-env tests for crashes with a frame of such motion. A bend of the next lane is not counted here.
    """
    lanes, leads_off = network.lanes_list(), np.zeros(len(after), bool)
    for k, row in enumerate(after):
        heading = lanes[k].heading_at(lanes[k].length)
        angles = [abs(np.sin(lanes[j].heading_at(0.0) - heading)) for j in row[row >= 0]]
        leads_off[k] = bool(angles) and min(angles) * distance > _BESIDE
    return leads_off


def bends_before_of(after: IntArray, bends: FloatArray) -> FloatArray:
    """Greatest curvature of the lanes that lead to each lane, (n,) [1/m]; `bends` are the lanes' own, (n,) [1/m]."""
    before = np.zeros(len(after))
    for k, row in enumerate(after):
        for j in row[row >= 0]:
            before[j] = max(before[j], bends[k])
    return before


def _takes_in(lane: Any, following: Any, entry: FloatArray) -> bool:
    """Whether a vehicle that drives straight on past the end of a lane counts as entering the next one, until
    `TURN_IN_DISTANCE` after the joint. `entry` is a row of `entries`."""
    heading = lane.heading_at(lane.length)
    forward, keep = np.array([np.cos(heading), np.sin(heading)]), WIDTH / 2 + _BESIDE_CENTRE
    for way in np.linspace(0.0, TURN_IN_DISTANCE, 7):
        center = lane.position(lane.length, 0.0) + way * forward
        s = following.local_coordinates(center)[0]
        angle = heading - following.heading_at(min(max(s, 0.0), following.length))
        sides = [following.local_coordinates(corner)[1] for corner in Vehicle(None, center, heading).polygon()]
        if np.cos(angle) < np.cos(TURNING) or min(sides) < entry[1] - keep or max(sides) > entry[2] + keep:
            return False
    return True


def _entries(table: IntArray, ends: FloatArray, lengths: FloatArray) -> FloatArray:
    """The least s, the least r and the greatest r at which vehicles enter each lane, (n, 3) [m]. They enter where the
    preceding lane ends, beside the centre; or beside it because they entered a short preceding lane beside its
    centre."""
    entries = np.zeros((len(table), 3))
    for _ in range(_PASSES):
        for k, row in enumerate(table):
            inherited = entries[k, 1:] if lengths[k] < RECENTRED_DISTANCE else np.zeros(2)
            for lane, (s, r, slack) in zip(row, ends[k], strict=True):
                if lane >= 0:
                    entries[lane, 0] = min(entries[lane, 0], s)
                    entries[lane, 1] = min(entries[lane, 1], min(r, 0.0) + inherited[0] - slack)
                    entries[lane, 2] = max(entries[lane, 2], max(r, 0.0) + inherited[1] + slack)
    return entries
