"""Time to collision of the ego in each lane at each target speed: highway-env's `TimeToCollision` observation."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynamics.compiled import kernel_no_refcount
from dynamics.highway_simulator.arithmetic import dot2, not_zero
from dynamics.highway_simulator.layout import COS, LANE, LENGTH, SIN, SPEED, TARGET_SPEED
from dynamics.road_networks.episodes.observe import RoadObservationConfig
from dynamics.road_networks.episodes.rewards import index_of_speed
from dynamics.road_networks.geometry.layout import ALONG, COUNT, ID, ROAD, ROUTE, ROUTE_END
from dynamics.road_networks.geometry.network import Network
from dynamics.road_networks.geometry.routes import NetworkTraffic, on_lane_of
from dynamics.state import FloatArray, IntArray

__all__ = ["ROWS", "TimeAheadWork", "time_ahead"]

ROWS = 9
"""Number of rows of the observation: three speeds by three lanes."""
_DEPTH = 3
"""Number of roads ahead that are searched."""


@kernel_no_refcount
def _leads(network: Network, route: IntArray, at: int, end: int, road: int, other: int, stack: IntArray) -> bool:
    """highway-env's `is_connected_road` of two roads, given entries `at` to `end` of a route from the first road.

    Parameters
    ----------
    stack : buffer, (3 times the roads that leave a node + 1 or more, 3), written.
    """
    roads, n = network.roads, 1
    stack[0, 0], stack[0, 1], stack[0, 2] = road, at, _DEPTH
    while n > 0:
        n -= 1
        here, entry, depth = stack[n, 0], stack[n, 1], stack[n, 2]
        if other == here or roads[other, 1] == roads[here, 0]:
            return True
        if depth == 0:
            continue
        while entry < end and route[entry, 0] == here:
            entry += 1
        if entry < end and roads[route[entry, 0], 0] == roads[here, 1]:
            stack[n, 0], stack[n, 1], stack[n, 2] = route[entry, 0], entry + 1, depth - 1
            n += 1
            continue
        for k in range(network.outs.shape[1]):
            following = network.outs[roads[here, 1], k]
            if following >= 0:
                stack[n, 0], stack[n, 1], stack[n, 2] = following, entry, depth - 1
                n += 1
    return False


@kernel_no_refcount
def _note(grid: FloatArray, lane: int, time: float, cost: float) -> None:
    """Mark a collision at a time step in a lane, or in all lanes if `lane` is -1."""
    if not 0 <= time < grid.shape[1]:
        return
    for k in range(grid.shape[0]):
        if lane < 0 or k == lane:
            grid[k, int(time)] = max(grid[k, int(time)], cost)


@kernel_no_refcount
def _fill(
    traffic: NetworkTraffic,
    view: RoadObservationConfig,
    ego: int,
    target_speed: float,
    vehicles: int,
    stack: IntArray,
    grid: FloatArray,
) -> None:
    """The collisions of the ego at a target speed, (lanes, steps), written."""
    f, g, p, ids, sums = traffic.f, traffic.g, traffic.p, traffic.lanes.ids, traffic.lanes.sums
    lane = g[LANE, ego]
    grid[:] = 0.0
    for i in range(vehicles):
        if i == ego or target_speed == f[SPEED, i]:
            continue
        margin = p[LENGTH, i] / 2 + p[LENGTH, ego] / 2
        apart = on_lane_of(traffic, i, lane)[0] - f[ALONG, ego]
        projected = f[SPEED, i] * dot2(sums, f[COS, i], f[COS, ego], f[SIN, i], f[SIN, ego])
        closing = not_zero(target_speed - projected)
        if max(apart / closing, max((apart - margin) / closing, (apart + margin) / closing)) < 0:
            continue
        road, other, end = ids[lane, ROAD], ids[g[LANE, i], ROAD], g[ROUTE_END, ego]
        if not _leads(traffic.network, traffic.routes[ego], g[ROUTE, ego], end, road, other, stack):
            continue
        same = ids[g[LANE, i], COUNT] == ids[lane, COUNT]
        for k in range(3):
            ahead = apart + (0.0 if k == 0 else -margin if k == 1 else margin)
            time = ahead / closing
            if time < 0:
                continue
            steps, into = time / view.step, ids[g[LANE, i], ID] if same else -1
            _note(grid, into, math.floor(steps), 1.0 if k == 0 else 0.5)
            _note(grid, into, math.ceil(steps), 1.0 if k == 0 else 0.5)


class TimeAheadWork(NamedTuple):
    """Buffers of `time_ahead`: of `_leads`, and one of (greatest number of lanes of a road, steps)."""

    stack: IntArray
    buffer: FloatArray


@kernel_no_refcount
def time_ahead(
    traffic: NetworkTraffic,
    view: RoadObservationConfig,
    ego: int,
    target_speeds: FloatArray,
    vehicles: int,
    work: TimeAheadWork,
    out: NDArray[np.float32],
) -> None:
    """Write the collisions at the ego's target speed and the next lower and higher, in its lane and those beside it, to
    `out`, (ROWS, steps). Where there is no lane, the value is 1."""
    ids, lane = traffic.lanes.ids, traffic.g[LANE, ego]
    count, index = ids[lane, COUNT], ids[lane, ID]
    grid, filled = work.buffer[:count], -1
    speed_index = index_of_speed(target_speeds, traffic.f[TARGET_SPEED, ego])
    for row in range(ROWS):
        speed = min(max(speed_index + row // 3 - 1, 0), len(target_speeds) - 1)
        if speed != filled:
            _fill(traffic, view, ego, target_speeds[speed], vehicles, work.stack, grid)
            filled = speed
        other = index + row % 3 - 1
        for k in range(view.steps):
            out[row, k] = np.float32(grid[other, k] if 0 <= other < count else 1.0)
