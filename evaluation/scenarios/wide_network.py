"""highway-env's road network, with the nearest lane found among the few that can be it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from highway_env.road.lane import AbstractLane
from highway_env.road.road import LaneIndex, RoadNetwork

from dynamics.state import FloatArray

__all__ = ["WideNetwork"]

_SAMPLES = 9
_SLACK = 1.0
"""What the samples of a lane may miss of the circle around it [m]: more than any of a course's lanes needs."""


class WideNetwork(RoadNetwork):  # type: ignore[misc]
    """A `RoadNetwork` whose `get_closest_lane_index` answers the same, and faster where there are many lanes.

    highway-env's distance to a lane is the length of a way to it, so it is no less than the distance to a circle around
    the lane. A lane whose circle is farther than another lane is not asked.

    Parameters
    ----------
    lanes : (node, node, lane) of each lane, in the order in which they are added.

    Examples
    --------
    >>> from highway_env.road.lane import StraightLane
    >>> first, second = StraightLane([0.0, 0.0], [50.0, 0.0]), StraightLane([50.0, 0.0], [90.0, 0.0])
    >>> network = WideNetwork([("a", "b", first), ("b", "c", second)])
    >>> network.get_closest_lane_index(np.array([60.0, 1.0]), 0.0)
    ('b', 'c', 0)
    """

    def __init__(self, lanes: Iterable[tuple[str, str, AbstractLane]] = ()) -> None:
        super().__init__()
        for start, end, lane in lanes:
            super().add_lane(start, end, lane)
        self._index()

    def add_lane(self, _from: str, _to: str, lane: AbstractLane) -> None:
        """Add a lane between two nodes."""
        super().add_lane(_from, _to, lane)
        self._index()

    def _index(self) -> None:
        # The order in which highway-env asks: of lanes that are equally near the first is taken.
        found = self.lanes_dict()
        self._indexes: list[LaneIndex] = list(found)
        self._lanes: list[AbstractLane] = list(found.values())
        self._circles = np.array([_circle(lane) for lane in self._lanes]).reshape(-1, 3)

    def get_closest_lane_index(self, position: FloatArray, heading: float | None = None) -> LaneIndex:
        """The lane nearest to a position [m], a heading [rad] counting as well where one is given."""
        away = np.hypot(self._circles[:, 0] - position[0], self._circles[:, 1] - position[1]) - self._circles[:, 2]
        near = self._lanes[int(away.argmin())].distance_with_heading(position, heading)
        asked = np.flatnonzero(away <= near)
        distances = [self._lanes[i].distance_with_heading(position, heading) for i in asked]
        return self._indexes[int(asked[int(np.argmin(distances))])]


def _circle(lane: AbstractLane) -> FloatArray:
    """A circle around a lane: x, y, radius [m], shape (3,)."""
    points = np.array([lane.position(along, 0.0) for along in np.linspace(0.0, lane.length, _SAMPLES)])
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return np.array([*middle, np.hypot(*(points - middle).T).max() + _SLACK])
