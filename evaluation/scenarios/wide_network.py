"""highway-env's road network with a faster search for the nearest lane."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from highway_env.road.lane import AbstractLane
from highway_env.road.road import LaneIndex, RoadNetwork

from dynamics.state import FloatArray

__all__ = ["WideNetwork"]

_SAMPLES = 9
_SLACK = 1.0
"""Margin of a lane's circle for points between its samples [m]; larger than any lane of a map needs."""


class WideNetwork(RoadNetwork):  # type: ignore[misc]
    """A `RoadNetwork` with a faster `get_closest_lane_index` on many lanes; its result is the same.

    highway-env's distance to a lane is the length of a path to it, so it is at least the distance to a circle around
    the lane. Lanes with a circle farther away than another lane are skipped.

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
        # highway-env's order: of equally near lanes the first is taken.
        found = self.lanes_dict()
        self._indexes: list[LaneIndex] = list(found)
        self._lanes: list[AbstractLane] = list(found.values())
        self._circles = np.array([_circle(lane) for lane in self._lanes]).reshape(-1, 3)

    def get_closest_lane_index(self, position: FloatArray, heading: float | None = None) -> LaneIndex:
        """Index of the lane nearest to a position [m], with regard to a heading [rad] if it is given."""
        away = np.hypot(self._circles[:, 0] - position[0], self._circles[:, 1] - position[1]) - self._circles[:, 2]
        near = self._lanes[int(away.argmin())].distance_with_heading(position, heading)
        candidates = np.flatnonzero(away <= near)
        distances = [self._lanes[i].distance_with_heading(position, heading) for i in candidates]
        return self._indexes[int(candidates[int(np.argmin(distances))])]


def _circle(lane: AbstractLane) -> FloatArray:
    """A circle around a lane: x, y, radius [m], (3,)."""
    points = np.array([lane.position(along, 0.0) for along in np.linspace(0.0, lane.length, _SAMPLES)])
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return np.array([*middle, np.hypot(*(points - middle).T).max() + _SLACK])
