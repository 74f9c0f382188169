"""Description of another vehicle from the ego's position, in the world frame: for road networks and simulated
traffic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.state import FloatArray
from shield.explanation import Obstruction

__all__ = ["VehicleIdentity", "describe", "lane_of", "place"]


@dataclass(frozen=True, slots=True)
class VehicleIdentity:
    """Identity of another vehicle: the object, or its column where there are no objects, and its lane."""

    vehicle: Any
    lane: str = ""


def describe(ego: FloatArray, row: FloatArray, identity: VehicleIdentity) -> Obstruction:
    """Description of another vehicle.

    Parameters
    ----------
    ego, row : x, y [m], heading [rad], speed [m/s], length, width [m] of the ego and of the other vehicle.
    identity : its identity.
    """
    dx, dy, cos, sin = row[0] - ego[0], row[1] - ego[1], np.cos(ego[2]), np.sin(ego[2])
    along, across = float(dx * cos + dy * sin), float(dy * cos - dx * sin)
    c, s = abs(np.cos(row[2] - ego[2])), abs(np.sin(row[2] - ego[2]))
    length, width = 0.5 * float(ego[4] + row[4] * c + row[5] * s), 0.5 * float(ego[5] + row[4] * s + row[5] * c)
    where, distance = place(along, across, length, width)
    named = not isinstance(identity.vehicle, int)
    kind = type(identity.vehicle).__name__ if named else f"vehicle {identity.vehicle}"
    return Obstruction(identity.vehicle, kind, where, distance, identity.lane, float(row[3]))


def place(along: float, across: float, length: float, width: float) -> tuple[str, float]:
    """Direction of another vehicle from the ego, and the gap in that direction [m].

    Parameters
    ----------
    along, across : position of its centre relative to the ego's, ahead and to the right [m].
    length, width : half the sums of both bodies' extents [m].
    """
    if abs(along) >= length:
        return "ahead" if along > 0 else "behind", abs(along) - length
    return "to the right" if across > 0 else "to the left", max(abs(across) - width, 0.0)


def lane_of(index: tuple[str, str, int]) -> str:
    """Name of a lane of a network, such as "lane 0 from nx to ne"."""
    return f"lane {index[2]} from {index[0]} to {index[1]}"
