"""highway-env's road with rights of way, for networks in which most vehicles are far from each other."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from highway_env.road.regulation import RegulatedRoad
from highway_env.vehicle.controller import ControlledVehicle

__all__ = ["HORIZON", "REACH", "PriorityRoad"]

HORIZON = 3
"""Time ahead over which two vehicles are compared [s]."""
REACH = 20.0
"""Upper bound on what bodies, lanes and the stretching of curves add to the distance driven [m]."""


class PriorityRoad(RegulatedRoad):  # type: ignore[misc]
    """A `RegulatedRoad` on which a vehicle yields to the one that it follows, independent of the priorities of their
    lanes.

    Priorities are for ways that cross. Where the lane ahead has a lower priority than the lane behind, highway-env
    stops the leader. Vehicles too far apart to meet in time are not compared. The route of a vehicle near the end of a
    road may begin after its lane. highway-env then predicts a wrong position, and other vehicles stop for it.
    """

    @staticmethod
    def respect_priorities(v1: Any, v2: Any) -> Any:
        """The one of two vehicles that yields."""
        for one, other in ((v1, v2), (v2, v1)):
            if one.lane_index[1] == other.lane_index[0]:
                return one
        return RegulatedRoad.respect_priorities(v1, v2)

    @staticmethod
    def is_conflict_possible(v1: Any, v2: Any, horizon: int = HORIZON, step: float = 0.25) -> bool:
        """Whether two vehicles come to overlap within the horizon [s]. As in highway-env, but vehicles that cannot meet
        are excluded first, and the copy of a vehicle does not include its road."""
        apart = np.hypot(*(v1.position - v2.position))
        if apart > horizon * (abs(v1.speed) + abs(v2.speed)) + REACH:
            return False
        return bool(RegulatedRoad.is_conflict_possible(_alone(v1), _alone(v2), horizon, step))


def _alone(vehicle: Any) -> Any:
    """The vehicle itself if it predicts along its route, else a copy without a road. highway-env deep-copies a vehicle
    to predict it. An `act` set on the instance is left out of the copy, since it would act on the vehicle itself."""
    if isinstance(vehicle, ControlledVehicle):
        return vehicle
    probe = copy.copy(vehicle)
    vars(probe).pop("act", None)
    probe.road = probe.lane = None
    return probe
