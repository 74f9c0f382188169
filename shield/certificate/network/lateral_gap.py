"""Gap across a lane between the ego and a vehicle in one of its reachable intervals; notation as in
`shield.certificate.network.clearance`."""

from __future__ import annotations

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.road_networks.geometry.lanes import NetworkLanes
from dynamics.road_networks.geometry.layout import AMPLITUDE, PULSATION, SHAPE, SINE
from dynamics.road_networks.reachable.strips import BODY_HALF, CENTRED_FROM, CENTRED_HALF, HIGH, LOW, NEAR, curvature
from dynamics.state import FloatArray, Vehicle
from shield.certificate.network.workspace import NetworkContext, NetworkVehicles

__all__ = ["lateral_gap", "sag_of"]

_LENGTH, _SPEED = int(Vehicle.LENGTH), int(Vehicle.SPEED)


@kernel_no_refcount
def _tangent_displacement(lanes: NetworkLanes, lane: int, length: float, way: float) -> float:
    """Displacement of the front of a body across the lane [m], if the body points along the lane and moves straight on
    for `way` [m]; `length` is that of the body [m]."""
    bend = curvature(lanes, lane)
    if lanes.ids[lane, SHAPE] == SINE:
        bend = abs(lanes.rows[lane, AMPLITUDE]) * lanes.rows[lane, PULSATION] * lanes.rows[lane, PULSATION]
    return 0.5 * bend * (length * way + way * way)


@kernel_no_refcount
def sag_of(others: NetworkVehicles, road: NetworkContext, j: int) -> float:
    """Upper bound on `_tangent_displacement` [m] within one frame, for the vehicle of reachable interval j."""
    i = others.marks[j, 0]
    row = others.rows[i]
    way = max(others.drive[i, 0], row[_SPEED], 0.0) * road.period
    return _tangent_displacement(road.lanes, others.marks[j, 1], row[_LENGTH], way)


@kernel_no_refcount
def _extra_lateral_gap(road: NetworkContext, lane: int, its: float, speed: float) -> float:
    """Lateral separation [m] that the ego's body and another body need beyond the ego's buffer.

    highway-env moves both bodies straight on for the coming frame and counts a collision if they meet. On a curved lane
    this brings the inner one of the two bodies nearer, and not the outer one. `its` is the other's `sag_of` [m],
    `speed` the ego's [m/s].
    """
    body = road.body
    own = _tangent_displacement(road.lanes, lane, 2 * body.length, max(speed, 0.0) * road.period)
    return max(max(its, own) - (body.across - body.width), 0.0)


@kernel_inline
def lateral_gap(road: NetworkContext, lane: int, box: FloatArray, row: FloatArray, its: float, speed: float) -> float:
    """Gap across the lane between the ego's box and a reachable interval, less `_extra_lateral_gap` [m]. Beyond
    `CENTRED_FROM`, a vehicle that came from beside the centre is back within `CENTRED_HALF` of it."""
    aside = _extra_lateral_gap(road, lane, its, speed)
    if box[0] - row[BODY_HALF] + row[NEAR] >= row[CENTRED_FROM]:
        return max(box[2] - row[CENTRED_HALF], -row[CENTRED_HALF] - box[3]) - aside
    return max(box[2] - row[HIGH], row[LOW] - box[3]) - aside
