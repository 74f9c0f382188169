"""Traffic of more than one kind of vehicle: classes that highway-env takes as `other_vehicles_type`."""

from __future__ import annotations

from typing import Any, ClassVar

from highway_env.vehicle.behavior import IDMVehicle

__all__ = ["Mixed", "Truck", "WithTrucks"]


class Truck(IDMVehicle):  # type: ignore[misc]
    """Drives as a car does, and is 12 m long and 2.5 m wide."""

    LENGTH = 12.0
    WIDTH = 2.5


class Mixed(IDMVehicle):  # type: ignore[misc]
    """What `MIX` names, in turn.

    Its classes drive in one way: they may differ in constants, but for those that are drawn.
    """

    MIX: ClassVar[tuple[type[IDMVehicle], ...]] = (IDMVehicle,)

    @classmethod
    def create_random(cls, road: Any, *args: Any, **kwargs: Any) -> Any:
        """The next vehicle on the road, whose first is the ego; see highway-env's `Vehicle.create_random`."""
        return cls.MIX[(len(road.vehicles) - 1) % len(cls.MIX)].create_random(road, *args, **kwargs)


class WithTrucks(Mixed):
    """Every third is a truck."""

    MIX = (IDMVehicle, IDMVehicle, Truck)
