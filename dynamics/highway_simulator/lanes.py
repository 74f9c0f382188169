"""Positions relative to the lanes: highway-env's `on_lane`, `is_reachable_from` and `get_closest_lane_index`."""

from __future__ import annotations

from dynamics.compiled import kernel_inline
from dynamics.highway_simulator.arithmetic import wrap_to_pi
from dynamics.highway_simulator.layout import LANE_LENGTH, LANE_WIDTH, LANE_Y
from dynamics.state import FloatArray

__all__ = ["MARGIN", "OVERHANG", "closest_lane", "lanes_at", "on_lane", "reachable"]

MARGIN = 1.0
"""Distance beyond a lane's edges within which a body counts as a neighbour on it [m]."""
OVERHANG = 5.0
"""`AbstractLane.VEHICLE_LENGTH`: length by which a lane extends beyond both its ends [m]."""


@kernel_inline
def on_lane(lanes: FloatArray, lane: int, x: float, y: float, margin: float) -> bool:
    """Whether a point is on a lane, or at most `margin` beyond its edges [m]."""
    return abs(y - lanes[lane, LANE_Y]) <= lanes[lane, LANE_WIDTH] / 2 + margin and (
        -OVERHANG <= x < lanes[lane, LANE_LENGTH] + OVERHANG
    )


@kernel_inline
def lanes_at(lanes: FloatArray, x: float, y: float) -> int:
    """The lanes that a body counts on, as bits."""
    bits = 0
    for lane in range(len(lanes)):
        if on_lane(lanes, lane, x, y, MARGIN):
            bits |= 1 << lane
    return bits


@kernel_inline
def reachable(lanes: FloatArray, lane: int, x: float, y: float) -> bool:
    """Whether a lane may be the target of a lane change from a point."""
    near = abs(y - lanes[lane, LANE_Y]) <= 2 * lanes[lane, LANE_WIDTH]
    return near and 0.0 <= x < lanes[lane, LANE_LENGTH] + OVERHANG


@kernel_inline
def closest_lane(lanes: FloatArray, x: float, y: float, heading: float) -> int:
    """The lane nearest in position and heading, the first among equals."""
    best, least, angle = 0, 0.0, abs(wrap_to_pi(heading - 0.0))
    for lane in range(len(lanes)):
        away = abs(y - lanes[lane, LANE_Y]) + max(x - lanes[lane, LANE_LENGTH], 0.0) + max(0.0 - x, 0.0) + 1.0 * angle
        if lane == 0 or away < least:
            best, least = lane, away
    return best
