"""Gap across a lane between the ego and a vehicle in one of its reachable intervals; notation as in
`shield.certificate.network.clearance`."""

from __future__ import annotations

from typing import NamedTuple

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.road_networks.geometry.lanes import NetworkLanes
from dynamics.road_networks.geometry.layout import AMPLITUDE, PULSATION, SHAPE, SINE
from dynamics.road_networks.reachable.strips import BODY_HALF, CENTRED_FROM, CENTRED_HALF, HIGH, LOW, NEAR, curvature
from dynamics.state import FloatArray, Vehicle
from dynamics.traffic.occupancy_kernels import straight_overshoot
from shield.certificate.network.workspace import NetworkContext, NetworkVehicles

__all__ = ["StraightMotion", "greatest_curvature", "lateral_gap", "straight_motion"]

_LENGTH, _SPEED = int(Vehicle.LENGTH), int(Vehicle.SPEED)


class StraightMotion(NamedTuple):
    """A frame of straight motion of a vehicle, by which highway-env tests for crashes.

    Attributes
    ----------
    way : greatest distance [m].
    aside, aside_at_start : greatest displacement of the front of its body across a lane [m]; the second where the
        vehicle may still point along the lane before.
    """

    way: float
    aside: float
    aside_at_start: float


@kernel_no_refcount
def greatest_curvature(lanes: NetworkLanes, lane: int) -> float:
    """Greatest curvature of a lane [1/m]."""
    if lanes.ids[lane, SHAPE] == SINE:
        return abs(lanes.rows[lane, AMPLITUDE]) * lanes.rows[lane, PULSATION] * lanes.rows[lane, PULSATION]
    return abs(curvature(lanes, lane))


@kernel_no_refcount
def straight_motion(others: NetworkVehicles, road: NetworkContext, j: int) -> StraightMotion:
    """A frame of straight motion of the vehicle of reachable interval j."""
    i, lane = others.marks[j, 0], others.marks[j, 1]
    row = others.rows[i]
    way = max(others.drive[i, 0], row[_SPEED], 0.0) * road.period
    aside = straight_overshoot(greatest_curvature(road.lanes, lane), row[_LENGTH], way)
    return StraightMotion(way, aside, max(aside, straight_overshoot(road.ways.bends_before[lane], row[_LENGTH], way)))


@kernel_no_refcount
def _extra_lateral_gap(road: NetworkContext, lane: int, its: float, speed: float) -> float:
    """Lateral separation [m] that the ego's body and another body need beyond the ego's buffer.

    highway-env moves both bodies straight on for the coming frame and counts a collision if they meet. On a curved lane
    this brings the inner one of the two bodies nearer, and not the outer one. `its` is the displacement of the other
    body across the lane [m], `speed` the ego's [m/s].
    """
    body = road.body
    own = straight_overshoot(greatest_curvature(road.lanes, lane), 2 * body.length, max(speed, 0.0) * road.period)
    return max(max(its, own) - (body.across - body.width), 0.0)


@kernel_inline
def lateral_gap(
    road: NetworkContext, lane: int, box: FloatArray, row: FloatArray, its: StraightMotion, speed: float
) -> float:
    """Gap across the lane between the ego's box and a reachable interval, less `_extra_lateral_gap` [m]. Beyond
    `CENTRED_FROM`, a vehicle that came from beside the centre is back within `CENTRED_HALF` of it."""
    at_start = box[0] <= its.way + row[BODY_HALF]
    aside = _extra_lateral_gap(road, lane, its.aside_at_start if at_start else its.aside, speed)
    if box[0] - row[BODY_HALF] + row[NEAR] >= row[CENTRED_FROM]:
        return max(box[2] - row[CENTRED_HALF], -row[CENTRED_HALF] - box[3]) - aside
    return max(box[2] - row[HIGH], row[LOW] - box[3]) - aside
