"""Traffic of more than one kind of vehicle: classes that highway-env takes as `other_vehicles_type`."""

from __future__ import annotations

from typing import Any, ClassVar

from highway_env.vehicle.behavior import IDMVehicle

__all__ = ["Mixed", "Truck", "WithTrucks"]


class Truck(IDMVehicle):  # type: ignore[misc]
    """A vehicle 12 m long and 2.5 m wide that drives as an `IDMVehicle` does."""

    LENGTH = 12.0
    WIDTH = 2.5


class Mixed(IDMVehicle):  # type: ignore[misc]
    """Vehicles of the classes in `MIX`, in turn.

    The classes share the driving model. They may differ in constants, except in those that are drawn at random.
    """

    MIX: ClassVar[tuple[type[IDMVehicle], ...]] = (IDMVehicle,)

    @classmethod
    def create_random(cls, road: Any, *args: Any, **kwargs: Any) -> Any:
        """The next vehicle on a road with the ego as its first vehicle; see highway-env's `Vehicle.create_random`."""
        return cls.MIX[(len(road.vehicles) - 1) % len(cls.MIX)].create_random(road, *args, **kwargs)


class WithTrucks(Mixed):
    """Traffic in which every third vehicle is a truck."""

    MIX = (IDMVehicle, IDMVehicle, Truck)
