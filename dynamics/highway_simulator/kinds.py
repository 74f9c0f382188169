"""The vehicle classes that the simulator supports, and the constants that they may override."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from highway_env.vehicle.behavior import AggressiveVehicle, DefensiveVehicle, IDMVehicle, LinearVehicle

from dynamics.errors import ConfigError
from dynamics.highway_simulator.layout import IDM, LINEAR, P
from dynamics.state import FloatArray
from dynamics.traffic.mixed import Mixed

__all__ = ["CONSTANTS", "constants_of", "kind_of", "mix_of", "ranges_of"]

_IN_ORDER = (
    "MAX_SPEED",
    "MIN_SPEED",
    "ACC_MAX",
    "COMFORT_ACC_MAX",
    "DISTANCE_WANTED",
    "TIME_WANTED",
    "DELTA",
    "POLITENESS",
    "LANE_CHANGE_MIN_ACC_GAIN",
    "LANE_CHANGE_MAX_BRAKING_IMPOSED",
    "LANE_CHANGE_DELAY",
)
"""Constants in the order of `layout`. There, length, width and diagonal come before the first, and twice the root of
the product of IDM's accelerations after the fourth."""
CONSTANTS = frozenset(
    {
        *_IN_ORDER,
        "LENGTH",
        "WIDTH",
        "COMFORT_ACC_MIN",
        "ACCELERATION_PARAMETERS",
        "STEERING_PARAMETERS",
        "DELTA_RANGE",
        "ACCELERATION_RANGE",
        "STEERING_RANGE",
        "DEFAULT_INITIAL_SPEEDS",
        "HISTORY_SIZE",
    }
)
"""Attributes that a vehicle, or a class of vehicles, may override."""
_DRAWN = 6
"""Number of parameters that may be drawn for each vehicle: IDM's exponent, and the linear model's five."""
_MADE = ("__init__", "__new__", "__getattr__", "__getattribute__")
_STOCK = (IDMVehicle, LinearVehicle, AggressiveVehicle, DefensiveVehicle)


def kind_of(vehicle: Any) -> int:
    """Driving model of a class of vehicles: `IDM` or `LINEAR`. The class may override constants, and nothing else.

    Raises
    ------
    ConfigError
        If it has another driving model.
    """
    if isinstance(vehicle, type) and issubclass(vehicle, Mixed):
        mix = mix_of(vehicle)
        kinds = {kind_of(each) for each in mix}
        if len(kinds) > 1 or not all(np.array_equal(ranges_of(mix[0]), ranges_of(each)) for each in mix):
            raise ConfigError(f"{vehicle.__name__} mixes classes that drive, or are drawn, in different ways")
        return kinds.pop()
    own: set[str] = set()
    for each in vehicle.__mro__ if isinstance(vehicle, type) else ():
        if each in _STOCK:
            if own:
                raise ConfigError(f"{vehicle.__name__} has {', '.join(sorted(own))} of its own")
            return LINEAR if issubclass(each, LinearVehicle) else IDM
        own |= {name for name in vars(each) if not name.startswith(("__", "_abc_")) and name not in CONSTANTS}
        own |= {name for name in vars(each) if name in _MADE}
    raise ConfigError(f"{getattr(vehicle, '__name__', vehicle)} does not drive as IDMVehicle or LinearVehicle do")


def mix_of(vehicle: type[Any]) -> tuple[type[Any], ...]:
    """The classes of which traffic of a class consists, in turn: the class itself, except for `Mixed`.

    Raises
    ------
    ConfigError
        If a subclass of `Mixed` overrides more than `MIX`, or `MIX` is empty or nested.
    """
    if not issubclass(vehicle, Mixed):
        return (vehicle,)
    own = {name for each in vehicle.__mro__[: vehicle.__mro__.index(Mixed)] for name in vars(each)}
    own -= {"MIX"} | {name for name in own if name.startswith(("__", "_abc_")) and name not in _MADE}
    if own:
        raise ConfigError(f"{vehicle.__name__} has {', '.join(sorted(own))} of its own, and not MIX alone")
    nested = [each.__name__ for each in vehicle.MIX if issubclass(each, Mixed)]
    if nested or not vehicle.MIX:
        raise ConfigError(f"{vehicle.__name__}.MIX has {', '.join(nested) or 'nothing'}; name the classes themselves")
    return vehicle.MIX


def constants_of(vehicle: Any) -> FloatArray:
    """The constants of a vehicle, or of a class of vehicles, (P,); 0 for those that it lacks (see `layout`)."""
    numbers = np.zeros(P)
    root = 2 * math.sqrt(-getattr(vehicle, "COMFORT_ACC_MAX", 0.0) * getattr(vehicle, "COMFORT_ACC_MIN", 0.0))
    length, width = vehicle.LENGTH, vehicle.WIDTH
    numbers[: len(_IN_ORDER) + 4] = [
        length,
        width,
        math.sqrt(length**2 + width**2),
        *(getattr(vehicle, name, 0.0) for name in _IN_ORDER[:4]),
        root,
        *(getattr(vehicle, name, 0.0) for name in _IN_ORDER[4:]),
    ]
    if hasattr(vehicle, "ACCELERATION_PARAMETERS"):
        numbers[len(_IN_ORDER) + 4 : len(_IN_ORDER) + 7] = vehicle.ACCELERATION_PARAMETERS
        numbers[len(_IN_ORDER) + 7 :] = vehicle.STEERING_PARAMETERS
    return numbers


def ranges_of(vehicle: Any) -> FloatArray:
    """The ranges of the parameters that are drawn for each vehicle of a class, (_DRAWN, 2)."""
    ranges = np.zeros((_DRAWN, 2))
    ranges[0] = getattr(vehicle, "DELTA_RANGE", (0.0, 0.0))
    if issubclass(vehicle, LinearVehicle):
        ranges[1:4] = np.transpose(vehicle.ACCELERATION_RANGE)
        ranges[4:6] = np.transpose(vehicle.STEERING_RANGE)
    return ranges
