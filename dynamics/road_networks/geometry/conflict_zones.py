"""Conflict zones: places where lanes of different roads overlap. They cross, join, part, or oppose one another.

Notation
--------
The *strip* of a lane is the set of points within half its width of its centre line, from its start to its end. A zone
is a connected part of the overlap of two strips.
"""

from __future__ import annotations

from enum import StrEnum
from functools import partial
from typing import NamedTuple

import numpy as np
import shapely

from dynamics.road_networks.geometry.layout import CIRCULAR, RADIUS, ROAD, SHAPE
from dynamics.road_networks.geometry.road_geometry import RoadGeometry
from dynamics.state import FloatArray, wrap_to_pi

__all__ = ["ConflictZone", "Meeting", "conflict_zones"]

_LEAST = 0.01
"""Least area of a zone [m^2]. Adjacent lanes overlap by less, because chords approximate the arcs of their edges."""
_NEAR = 0.5
"""A zone that comes this near to an end of a lane reaches it [m]."""
_FROM, _TO = 0, 1
"""Columns of `Network.roads`."""
_Interval = tuple[float, float]


class Meeting(StrEnum):
    """How two lanes meet."""

    CROSS = "cross"
    JOIN = "join"
    PART = "part"
    ONCOMING = "oncoming"


class ConflictZone(NamedTuple):
    """A connected part of the overlap of two lanes of different roads.

    Lanes *join* where their roads lead to the same node and one of them ends in the zone. They *part* where they leave
    the same node and one of them begins in the zone. Other lanes are *oncoming* if their directions oppose and their
    centre lines do not cross, and else *cross*.

    Attributes
    ----------
    lane, other : their numbers. kind : how they meet.
    interval, other_interval : the least and the greatest s of the zone on either [m].
    outline : its corners, (k, 2) [m].
    """

    lane: int
    other: int
    kind: Meeting
    interval: tuple[float, float]
    other_interval: tuple[float, float]
    outline: FloatArray

    def mirrored(self) -> ConflictZone:
        """The same zone with the two lanes exchanged."""
        return ConflictZone(self.other, self.lane, self.kind, self.other_interval, self.interval, self.outline)


def conflict_zones(geometry: RoadGeometry) -> tuple[ConflictZone, ...]:
    """Every zone of a network twice, once for either lane, sorted by lane number and then s.

    Lanes of the same road are not compared. The overlap of a lane with the lane that continues it is no zone.
    """
    strips = shapely.make_valid([shapely.Polygon(geometry.outline(lane)) for lane in range(len(geometry.names))])
    roads = geometry.network.ids[:, ROAD]
    lanes, others = shapely.STRtree(strips).query(strips, predicate="intersects")
    apart = (lanes < others) & (roads[lanes] != roads[others])
    lanes, others = lanes[apart], others[apart]
    parts, pairs = shapely.get_parts(shapely.intersection(strips[lanes], strips[others]), return_index=True)
    large = shapely.area(parts) > _LEAST
    found = zip(lanes[pairs[large]].tolist(), others[pairs[large]].tolist(), parts[large], strict=True)
    zones = [zone for a, b, part in found if (zone := _zone(geometry, a, b, part)) is not None]
    both = zones + [zone.mirrored() for zone in zones]
    return tuple(sorted(both, key=lambda zone: (zone.lane, zone.other, zone.interval)))


def _zone(geometry: RoadGeometry, a: int, b: int, part: shapely.Polygon) -> ConflictZone | None:
    """A connected part as a zone; None if one lane continues the other there."""
    outline = shapely.get_coordinates(part.exterior)[:-1]
    own, other = (_interval(geometry, lane, outline) for lane in (a, b))
    if _follows(geometry, a, b, own) or _follows(geometry, b, a, other):
        return None
    kind = _meeting_at_node(geometry, (a, b), (own, other)) or _meeting_between(geometry, (a, b), (own, other), part)
    return ConflictZone(a, b, kind, own, other, outline)


def _interval(geometry: RoadGeometry, lane: int, points: FloatArray) -> _Interval:
    """The least and the greatest s of points on a lane [m]."""
    s, _ = geometry.project(lane, points[:, 0], points[:, 1])
    length = float(geometry.lengths[lane])
    if geometry.network.ids[lane, SHAPE] == CIRCULAR:
        # The end of an arc of half a circle, or more, is projected before its start.
        radius = geometry.network.lanes[lane, RADIUS]
        s = length / 2 + radius * wrap_to_pi((s - length / 2) / radius)
    return max(0.0, float(s.min())), min(length, float(s.max()))


def _node(geometry: RoadGeometry, lane: int, end: int) -> int:
    """The node at one end of the road of a lane, `_FROM` or `_TO`."""
    return int(geometry.network.roads[geometry.network.ids[lane, ROAD], end])


def _agreement(geometry: RoadGeometry, a: int, s: float, b: int, t: float) -> float:
    """Cosine of the angle between the directions of two lanes."""
    return float(np.cos(geometry.heading(a, s) - geometry.heading(b, t)))


def _at_end(geometry: RoadGeometry, lane: int, interval: _Interval) -> bool:
    """Whether an interval reaches the end of a lane."""
    return bool(interval[1] > geometry.lengths[lane] - _NEAR)


def _follows(geometry: RoadGeometry, a: int, b: int, interval: _Interval) -> bool:
    """Whether lane `b` continues lane `a` at a zone, which has an interval on lane `a`."""
    joint = _node(geometry, a, _TO) == _node(geometry, b, _FROM) and _at_end(geometry, a, interval)
    return joint and _agreement(geometry, a, float(geometry.lengths[a]), b, 0.0) > 0


def _meeting_at_node(
    geometry: RoadGeometry, lanes: tuple[int, int], intervals: tuple[_Interval, _Interval]
) -> Meeting | None:
    """How two lanes meet that join at a node or part at a node in the zone; None for others."""
    starts, ends = ([_node(geometry, lane, end) for lane in lanes] for end in (_FROM, _TO))
    if ends[0] == ends[1] and any(map(partial(_at_end, geometry), lanes, intervals)):
        return Meeting.JOIN
    if starts[0] == starts[1] and any(first < _NEAR for first, _ in intervals):
        return Meeting.PART
    return None


def _meeting_between(
    geometry: RoadGeometry, lanes: tuple[int, int], intervals: tuple[_Interval, _Interval], part: shapely.Polygon
) -> Meeting:
    """How lanes meet that neither join nor part in the zone."""
    (a, b), (s, t) = lanes, (sum(each) / 2 for each in intervals)
    middles = [shapely.LineString(geometry.outline(lane, low=0.0, high=0.0)) for lane in lanes]
    points = shapely.intersection(shapely.intersection(*middles), part)
    crossing = not points.is_empty and points.length == 0
    return Meeting.ONCOMING if _agreement(geometry, a, s, b, t) < 0 and not crossing else Meeting.CROSS
