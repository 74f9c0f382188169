"""Roads of two lanes as highway-env's lanes, placed by a frame.

Notation: a frame has its origin on the axis of a two-way road and x along it. y points to the right, as in highway-env,
where y points down. In each direction lane 0 is next to the axis and lane 1 to its right. All lengths are in m. Angles
are in rad, clockwise on the screen.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any, NamedTuple

import numpy as np
from highway_env.road.lane import AbstractLane, CircularLane, LineType, SineLane, StraightLane

from dynamics.state import FloatArray, wrap_to_pi

__all__ = ["ARM_SPEED", "OFFSETS", "ROAD_SPEED", "TURN_SPEED", "WIDTH", "Kind", "Lines", "RoadFrame", "RoadLanes"]

WIDTH = AbstractLane.DEFAULT_WIDTH
"""Width of a lane [m]."""
OFFSETS = (0.5 * WIDTH, 1.5 * WIDTH)
"""Lateral positions of the two lanes of a direction, to the right of the axis [m]."""
ROAD_SPEED, ARM_SPEED, TURN_SPEED = 15.0, 10.0, 8.0
"""Speed limits of straights and merges, of arms of a crossing, and within a crossing [m/s]."""

_NONE, _STRIPED, _SOLID = LineType.NONE, LineType.STRIPED, LineType.CONTINUOUS


class Lines(Enum):
    """Markings to the left and the right of each of two lanes."""

    ROAD = ((_SOLID, _STRIPED), (_NONE, _SOLID))
    MOUTH = ((_SOLID, _STRIPED), (_NONE, _STRIPED))
    EDGE = ((_NONE, _NONE), (_NONE, _SOLID))
    NONE = ((_NONE, _NONE), (_NONE, _NONE))


class Kind(NamedTuple):
    """Attributes of highway-env's lanes beside their shape.

    Attributes
    ----------
    speed_limit : speed limit [m/s].
    priority : right of way at a crossing; the vehicle with the lower priority yields.
    lines : markings beside the lanes.
    """

    speed_limit: float
    priority: int
    lines: Lines = Lines.ROAD

    def of_lanes(self) -> list[dict[str, Any]]:
        """Keyword arguments of highway-env's two lanes."""
        return [
            {"line_types": list(lines), "speed_limit": self.speed_limit, "priority": self.priority}
            for lines in self.lines.value
        ]


RoadLanes = tuple[AbstractLane, ...]
"""The lanes of one road, from left to right."""


@dataclass(frozen=True, slots=True)
class RoadFrame:
    """A position and a direction.

    Attributes
    ----------
    x, y : the origin in the world frame [m].
    heading : direction of the x axis in the world frame [rad].

    Examples
    --------
    >>> frame = RoadFrame(10.0, 0.0, 0.0).at(5.0, 2.0, np.pi / 2)
    >>> frame.x, frame.y
    (15.0, 2.0)
    >>> left, right = frame.straight((0.0, 0.0), (30.0, 0.0), Kind(speed_limit=15.0, priority=0))
    >>> [float(round(lane.position(0.0, 0.0)[0], 9)) for lane in (left, right)]
    [13.0, 9.0]
    """

    x: float = 0.0
    y: float = 0.0
    heading: float = 0.0

    def point(self, x: float, y: float) -> FloatArray:
        """World position of a point of this frame [m], (2,)."""
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        return np.array([self.x + cos * x - sin * y, self.y + sin * x + cos * y])

    def at(self, x: float, y: float, turn: float = 0.0) -> RoadFrame:
        """The frame at a point of this one, turned to the right by `turn` [rad]."""
        place = self.point(x, y)
        return RoadFrame(float(place[0]), float(place[1]), float(wrap_to_pi(self.heading + turn)))

    def straight(self, start: tuple[float, float], end: tuple[float, float], kind: Kind) -> RoadLanes:
        """Two straight lanes to the right of the line from `start` to `end`.

        Parameters
        ----------
        start, end : points of this frame [m].
        kind : attributes of both lanes.
        """
        return tuple(
            StraightLane(
                self.point(*_beside(start, end, offset)[0]), self.point(*_beside(start, end, offset)[1]), **each
            )
            for offset, each in zip(OFFSETS, kind.of_lanes(), strict=True)
        )

    def shift(self, start: tuple[float, float], end: tuple[float, float], kind: Kind) -> RoadLanes:
        """Two lanes that shift from one line along x to another, along half a period of a sine.

        Parameters
        ----------
        start, end : points of this frame on the axis of the road before and after the shift [m].
        kind : as for `straight`.
        """
        length, amplitude = end[0] - start[0], 0.5 * (start[1] - end[1])
        middle = 0.5 * (start[1] + end[1])
        return tuple(
            SineLane(
                self.point(start[0], middle + offset),
                self.point(end[0], middle + offset),
                amplitude,
                np.pi / length,
                0.5 * np.pi,
                **each,
            )
            for offset, each in zip(OFFSETS, kind.of_lanes(), strict=True)
        )

    def arc(self, center: tuple[float, float], radius: float, start: float, end: float, kind: Kind) -> RoadLanes:
        """Two lanes to the right of an arc, which turns right if `end` is greater than `start`.

        Parameters
        ----------
        center : point of this frame [m].
        radius : radius of the arc [m].
        start, end : phases as seen from the centre, in this frame [rad].
        kind : as for `straight`.
        """
        clockwise = end > start
        side = 1.0 if clockwise else -1.0
        return tuple(
            CircularLane(
                self.point(*center),
                radius - side * offset,
                start + self.heading,
                end + self.heading,
                clockwise,
                **each,
            )
            for offset, each in zip(OFFSETS, kind.of_lanes(), strict=True)
        )


def _beside(start: tuple[float, float], end: tuple[float, float], offset: float) -> tuple[FloatArray, FloatArray]:
    a, b = np.array(start), np.array(end)
    along = (b - a) / np.hypot(*(b - a))
    right = offset * np.array([-along[1], along[0]])
    return a + right, b + right
