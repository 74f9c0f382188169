"""highway-env's road with rights of way, for networks in which most vehicles are far from each other."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from highway_env.road.regulation import RegulatedRoad
from highway_env.vehicle.controller import ControlledVehicle

__all__ = ["HORIZON", "REACH", "PriorityRoad"]

HORIZON = 3
"""How far ahead two vehicles are compared [s]."""
REACH = 20.0
"""More than the bodies, the lanes and the stretching of curves add to the way that is driven [m]."""


class PriorityRoad(RegulatedRoad):  # type: ignore[misc]
    """A `RegulatedRoad` on which who follows another yields to it, whatever the priorities of their lanes.

    Priorities are for ways that cross. Where the lane ahead has a lower one than the lane behind, highway-env stops
    whoever leads. Who is too far away to be met in time is not compared: highway-env takes a vehicle whose route is
    ahead of its lane, near the end of a road, to be somewhere else altogether, and has others stop for it.
    """

    @staticmethod
    def respect_priorities(v1: Any, v2: Any) -> Any:
        """The one of the two that yields."""
        for one, other in ((v1, v2), (v2, v1)):
            if one.lane_index[1] == other.lane_index[0]:
                return one
        return RegulatedRoad.respect_priorities(v1, v2)

    @staticmethod
    def is_conflict_possible(v1: Any, v2: Any, horizon: int = HORIZON, step: float = 0.25) -> bool:
        """Whether the two come to overlap within the horizon [s]: as highway-env has it, but who cannot meet is left
        out first, and no vehicle's copy takes the road with it."""
        apart = np.hypot(*(v1.position - v2.position))
        if apart > horizon * (abs(v1.speed) + abs(v2.speed)) + REACH:
            return False
        return bool(RegulatedRoad.is_conflict_possible(_alone(v1), _alone(v2), horizon, step))


def _alone(vehicle: Any) -> Any:
    """The vehicle itself where it predicts along its route, else a copy that is on no road: to predict, highway-env
    copies it with everything that it refers to. What stands in the place of its `act` would act on the vehicle."""
    if isinstance(vehicle, ControlledVehicle):
        return vehicle
    probe = copy.copy(vehicle)
    vars(probe).pop("act", None)
    probe.road = probe.lane = None
    return probe
