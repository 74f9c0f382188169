"""One of the others, seen from the ego in the world frame: on networks of roads, and where traffic is simulated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.state import FloatArray
from shield.explanation import Obstruction

__all__ = ["Described", "describe", "lane_of", "place"]


@dataclass(frozen=True, slots=True)
class Described:
    """What is said of one of the others: the object, or its column where there are none, and the lane that it is on."""

    vehicle: Any
    lane: str = ""


def describe(ego: FloatArray, row: FloatArray, who: Described) -> Obstruction:
    """One of the others.

    Parameters
    ----------
    ego, row : of the ego and of the other: x, y [m], heading [rad], speed [m/s], length, width [m].
    """
    dx, dy, cos, sin = row[0] - ego[0], row[1] - ego[1], np.cos(ego[2]), np.sin(ego[2])
    along, across = float(dx * cos + dy * sin), float(dy * cos - dx * sin)
    c, s = abs(np.cos(row[2] - ego[2])), abs(np.sin(row[2] - ego[2]))
    length, width = 0.5 * float(ego[4] + row[4] * c + row[5] * s), 0.5 * float(ego[5] + row[4] * s + row[5] * c)
    where, distance = place(along, across, length, width)
    named = not isinstance(who.vehicle, int)
    kind = type(who.vehicle).__name__ if named else f"vehicle {who.vehicle}"
    return Obstruction(who.vehicle, kind, where, distance, who.lane, float(row[3]))


def place(along: float, across: float, length: float, width: float) -> tuple[str, float]:
    """Where one of the others is seen from the ego, and how far it is from there [m].

    Parameters
    ----------
    along, across : of its centre from the ego's, ahead and to the right [m]. length, width : of both, halved [m].
    """
    if abs(along) >= length:
        return "ahead" if along > 0 else "behind", abs(along) - length
    return "to the right" if across > 0 else "to the left", max(abs(across) - width, 0.0)


def lane_of(index: tuple[str, str, int]) -> str:
    """The name of a lane of a network, such as "lane 0 from nx to ne"."""
    return f"lane {index[2]} from {index[0]} to {index[1]}"
