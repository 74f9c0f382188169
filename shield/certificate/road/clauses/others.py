"""The other vehicles, as the clauses read them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline
from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.traffic.tables import ReachableBodies

__all__ = ["TOUCH", "RoadVehicles", "VehicleBuffers", "empty_vehicles", "vehicles_from"]

TOUCH = 1.0
"""Distance from a lane's centre within which a body is in the way of that lane [m]: half the width of a car."""


class RoadVehicles(NamedTuple):
    """The other vehicles as the clauses read them, for v vehicles; arrays are (v,) unless stated.

    Attributes
    ----------
    ahead : s of the centre, relative to the ego's [m].
    least : the same for the least s that the centre ever reaches [m].
    size : longitudinal distance within which it counts as touching the ego [m].
    behind : whether its body is behind the ego and its buffer.
    low, high : band of the lanes that it touches [m]. lane : nearest lane.
    r, across : lateral position [m] and lateral speed [m/s].
    in_owned_lane : whether it is in a lane that the ego owns, or has had a distance obligation and the ego has not
        left its band.
    beside : lanes beside its band, (lanes, v). comes : which of these it may enter, (lanes, v).
    """

    ahead: FloatArray
    least: FloatArray
    size: FloatArray
    behind: BoolArray
    low: FloatArray
    high: FloatArray
    lane: IntArray
    r: FloatArray
    across: FloatArray
    in_owned_lane: BoolArray
    beside: BoolArray
    comes: BoolArray


class VehicleBuffers(NamedTuple):
    """The arrays that hold the fields of `RoadVehicles` beyond `ReachableBodies`: numbers (5, m), and flags
    (2 + 2 lanes, m)."""

    numbers: FloatArray
    flags: BoolArray


def empty_vehicles(m: int, lanes: int) -> VehicleBuffers:
    """Buffers for m vehicles."""
    return VehicleBuffers(np.empty((5, m)), np.zeros((2 + 2 * lanes, m), np.bool_))


@kernel_inline
def vehicles_from(bodies: ReachableBodies, numbers: FloatArray, flags: BoolArray) -> RoadVehicles:
    """The rows of both buffers, by their names."""
    ahead, least, size, r, across = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]
    behind, in_owned_lane, lanes = flags[0], flags[1], flags.shape[0] // 2 + 1
    beside, comes, lane = flags[2:lanes], flags[lanes:], bodies.lane
    return RoadVehicles(
        ahead, least, size, behind, bodies.low, bodies.high, lane, r, across, in_owned_lane, beside, comes
    )
