"""Traffic with a driver model that no compiled simulator supports."""

from __future__ import annotations

from highway_env.vehicle.behavior import IDMVehicle

__all__ = ["UNKNOWN", "Dozy"]


class Dozy(IDMVehicle):
    """An IDM vehicle that overlooks every chance of a lane change."""

    def act(self, action=None):
        """Stay on the lane."""
        self.timer = 0.0
        super().act(action)


UNKNOWN = {"other_vehicles_type": f"{__name__}.{Dozy.__name__}"}
"""The configuration of an environment with that traffic."""
