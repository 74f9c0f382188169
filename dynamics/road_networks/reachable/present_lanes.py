"""The lanes that a vehicle is on now: those that it keeps to, or else is entering, or else touches."""

from __future__ import annotations

import math
from typing import NamedTuple

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.arithmetic import wrap_to_pi
from dynamics.highway_simulator.layout import LANE_LENGTH, LANE_WIDTH
from dynamics.road_networks.geometry.footprints import LanePoint, Rectangle, extent_of
from dynamics.road_networks.geometry.lanes import NetworkLanes, heading_at, local, unrolled
from dynamics.road_networks.geometry.layout import ROAD
from dynamics.road_networks.reachable.continuations import RECENTRED_DISTANCE, TURN_IN_DISTANCE, TURNING
from dynamics.road_networks.reachable.strips import (
    DrivingBounds,
    LaneContinuations,
    Strip,
    Strips,
    add,
    body_front,
    body_half,
    centred_half,
    is_dead_end,
)
from dynamics.state import FloatArray, IntArray, Vehicle

__all__ = ["ALIGNED", "NetworkVehicle", "add_present_strips"]

_LENGTH, _WIDTH = int(Vehicle.LENGTH), int(Vehicle.WIDTH)
ALIGNED, _OVERLAY = 0.5, 2.0
"""Greatest deviation of a vehicle's heading from a lane of another road that it may follow: `ALIGNED` [rad], or
`TURNING` [rad] while it enters the lane. A vehicle between lanes also has to be within `_OVERLAY` of the centre [m].
Where roads part, several lanes satisfy this."""
_SWEEP = 0.5
"""How much further a body may reach while it turns into a lane from beside it [m]."""


class NetworkVehicle(NamedTuple):
    """A vehicle.

    Attributes
    ----------
    number : its index. row : its vehicle row, (7,). own : the lane that it is on.
    route : which roads are on its route, (roads,), see `prediction.spread`. limited : whether it keeps to them.
    drive : bounds on its motion, (5,), see `prediction.add_all_strips`. first : index of its first strip.
    """

    number: int
    row: FloatArray
    own: int
    route: IntArray
    limited: bool
    drive: FloatArray
    first: int


class _Pose(NamedTuple):
    """A body relative to a lane.

    Attributes
    ----------
    s, r : of its centre [m]. angle : to the lane [rad].
    low, high : least and greatest r [m]. half : half of its extent along the lane [m].
    front : how far its front is ahead of its centre [m].
    keep : how far it reaches to either side once it keeps to the centre [m].
    within : whether it is within the lane, or about to enter it.
    """

    s: float
    r: float
    angle: float
    low: float
    high: float
    half: float
    front: float
    keep: float
    within: bool


@kernel_no_refcount
def _pose(lanes: NetworkLanes, ways: LaneContinuations, bounds: DrivingBounds, row: FloatArray, lane: int) -> _Pose:
    """The pose of a vehicle (7,) on a lane."""
    s, r = local(lanes, lane, row[0], row[1])
    s = unrolled(lanes, lane, s)
    long, keep = lanes.rows[lane, LANE_LENGTH], centred_half(lanes, lane, row, bounds)
    angle = wrap_to_pi(row[2] - heading_at(lanes, lane, min(max(s, 0.0), long)))
    body = Rectangle(0.0, math.cos(row[2]), math.sin(row[2]), 0.5 * row[_LENGTH], 0.5 * row[_WIDTH])
    extent = extent_of(lanes, lane, LanePoint(row[0], row[1], s, r), body)
    half = max(extent.last - s, s - extent.first, body_half(lanes, lane, row, bounds))
    front, within = max(extent.last - s, body_front(row)), ways.entries[lane, 0] - TURN_IN_DISTANCE <= s
    within = within and (s <= long or is_dead_end(ways.after, lane))
    return _Pose(s, r, angle, extent.low, extent.high, half, front, keep, within)


@kernel_inline
def _off_route(lanes: NetworkLanes, subject: NetworkVehicle, lane: int) -> bool:
    """Whether a lane is off the route of a vehicle that keeps to its route."""
    return subject.limited and subject.route[lanes.ids[lane, ROAD]] == 0


@kernel_no_refcount
def _strip_of(subject: NetworkVehicle, lane: int, at: _Pose, low: float, high: float, back: float) -> Strip:
    """The strip of a lane that a vehicle is on."""
    return Strip(subject.number, lane, -1, -at.s, -at.s, low, high, at.half, min(at.s, 0.0), back, at.keep, at.front)


@kernel_no_refcount
def _kept(
    lanes: NetworkLanes,
    ways: LaneContinuations,
    bounds: DrivingBounds,
    subject: NetworkVehicle,
    strips: Strips,
    first: int,
) -> int:
    """Add the lanes to which a vehicle keeps, of its route or of all. If it has reached none of them yet it is between
    lanes, and none counts.

    Returns
    -------
    The number of strips.
    """
    count, some = first, False
    for lane in range(lanes.rows.shape[0]):
        if _off_route(lanes, subject, lane):
            continue
        at = _pose(lanes, ways, bounds, subject.row, lane)
        if at.within and abs(at.angle) <= ALIGNED and max(at.high, -at.low) <= at.keep:
            count = add(strips, first, count, _strip_of(subject, lane, at, -at.keep, at.keep, 0.0), 0.0)
            some = some or at.s >= 0.0
    return count if some else first


@kernel_no_refcount
def _entered(
    lanes: NetworkLanes,
    ways: LaneContinuations,
    bounds: DrivingBounds,
    subject: NetworkVehicle,
    strips: Strips,
    first: int,
) -> int:
    """Add the lanes that a vehicle is entering from beside them, and then also the lane that it is on. See `_kept` for
    the result."""
    count, some = first, False
    for lane in range(lanes.rows.shape[0]):
        if _off_route(lanes, subject, lane):
            continue
        at = _pose(lanes, ways, bounds, subject.row, lane)
        low, high = at.low, at.high
        if lane == subject.own:
            low, high = min(low, -at.keep), max(high, at.keep)
            count = add(strips, first, count, _strip_of(subject, lane, at, low, high, RECENTRED_DISTANCE), 0.0)
            continue
        least, most = -at.keep + ways.entries[lane, 1], at.keep + ways.entries[lane, 2]
        if at.within and abs(at.angle) <= TURNING and low >= least and high <= most:
            low, high = max(least, min(low - _SWEEP, -at.keep)), min(most, max(high + _SWEEP, at.keep))
            count = add(strips, first, count, _strip_of(subject, lane, at, low, high, RECENTRED_DISTANCE), 0.0)
            some = True
    return count if some else first


@kernel_no_refcount
def _chosen(
    lanes: NetworkLanes,
    ways: LaneContinuations,
    bounds: DrivingBounds,
    subject: NetworkVehicle,
    strips: Strips,
    first: int,
) -> int:
    """Add the lanes to which a vehicle keeps, or else those that it is entering. See `_kept` for the result."""
    count = _kept(lanes, ways, bounds, subject, strips, first)
    return count if count > first else _entered(lanes, ways, bounds, subject, strips, first)


@kernel_no_refcount
def _touched(
    lanes: NetworkLanes,
    ways: LaneContinuations,
    bounds: DrivingBounds,
    subject: NetworkVehicle,
    strips: Strips,
    first: int,
) -> int:
    """Add the lanes that a vehicle between lanes touches. See `_kept` for the result."""
    count = first
    for lane in range(lanes.rows.shape[0]):
        at = _pose(lanes, ways, bounds, subject.row, lane)
        if lane != subject.own:
            if lanes.ids[lane, ROAD] == lanes.ids[subject.own, ROAD]:
                if max(at.low, -at.high) >= lanes.rows[lane, LANE_WIDTH] / 2 - bounds.marking_tolerance:
                    continue
            elif not (abs(at.r) <= _OVERLAY and at.within and abs(at.angle) <= ALIGNED):
                continue
        low, high = min(at.low, -at.keep), max(at.high, at.keep)
        count = add(strips, first, count, _strip_of(subject, lane, at, low, high, RECENTRED_DISTANCE), 0.0)
    return count


@kernel_no_refcount
def add_present_strips(
    lanes: NetworkLanes,
    ways: LaneContinuations,
    bounds: DrivingBounds,
    subject: NetworkVehicle,
    strips: Strips,
) -> int:
    """Add the strips of the lanes that a vehicle is on. Lanes of its route come before all others.

    Returns
    -------
    The number of strips.
    """
    first = subject.first
    anywhere = NetworkVehicle(subject.number, subject.row, subject.own, subject.route, False, subject.drive, first)
    count = first
    if subject.limited:
        count = _chosen(lanes, ways, bounds, subject, strips, first)
    if count == first:
        count = _chosen(lanes, ways, bounds, anywhere, strips, first)
    return count if count > first else _touched(lanes, ways, bounds, anywhere, strips, first)
