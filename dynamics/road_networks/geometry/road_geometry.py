"""`RoadGeometry`: positions, headings and curvatures on the lanes of a road network, for many points at once.

Notation
--------
On a lane, s [m] is the distance along it from its start, negative before it. r [m] is the distance across, positive to
the right in the direction of travel. x, y [m] and heading [rad] are highway-env's; its y points down, so angles grow
clockwise. On a sine, s is along the line that it winds around and r across that line, as in highway-env.

A lane has a number, from 0 in highway-env's order, and a name, highway-env's index of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.road import RoadNetwork
from numpy.typing import ArrayLike, NDArray

from dynamics.errors import ConfigError, SceneError
from dynamics.highway_simulator.arithmetic import sums_of_numpy
from dynamics.highway_simulator.layout import LANE_LENGTH, LANE_WIDTH
from dynamics.highway_simulator.loops import addresses
from dynamics.road_networks.geometry.lanes import NetworkLanes
from dynamics.road_networks.geometry.layout import COUNT, ID, SHAPE, STRAIGHT
from dynamics.road_networks.geometry.network import Network, index_of, network_of
from dynamics.road_networks.geometry.points import closest_all, curvature_all, heading_all, position_all, project_all
from dynamics.road_networks.reachable.continuations import continuations_of, leads_over
from dynamics.state import FloatArray, IntArray

__all__ = ["Closest", "LaneName", "Neighbours", "RoadGeometry"]

LaneName = tuple[str, str, int]
"""highway-env's index of a lane: the nodes that its road leads from and to, and its number on the road."""
_SAMPLE = 0.5
"""Distance between two points of an outline on a curved lane [m]."""


class Neighbours(NamedTuple):
    """The numbers of the lanes to either side on the same road; None where there is none."""

    left: int | None
    right: int | None


class Closest(NamedTuple):
    """The lanes nearest to some points: their numbers, and s and r on them [m], of the shape of the points."""

    lane: IntArray
    s: FloatArray
    r: FloatArray


@dataclass(frozen=True, eq=False)
class RoadGeometry:
    """The lanes of a road network of highway-env, with straight, sine and circular lanes; see `of`.

    Methods for many points take arrays that broadcast against one another, and return arrays of their common shape. The
    results equal highway-env's to the bit, except `position` beside the centre line. Later changes of the network are
    not followed.

    Attributes
    ----------
    names : highway-env's index of each lane, (n,). network, lanes : their arrays, see
        `dynamics.road_networks.geometry.network`.
    after : the numbers of the lanes that follow each lane. over : for a lane that ends, the neighbouring lane that a
        vehicle has to change to, (n,), -1 for none.

    Examples
    --------
    >>> geometry = RoadGeometry.of(gym.make("merge-v1"))
    >>> ramp = geometry.number(("k", "b", 0))
    >>> s, r = geometry.project(ramp, [300.0, 310.0], [12.0, 10.0])
    >>> geometry.names[geometry.successors(ramp)[0]]
    ('b', 'c', 2)
    """

    names: tuple[LaneName, ...]
    network: Network
    lanes: NetworkLanes
    after: tuple[tuple[int, ...], ...]
    over: IntArray

    @classmethod
    def of(cls, source: RoadNetwork | gym.Env[Any, Any]) -> RoadGeometry:
        """Read a `RoadNetwork`, or that of an environment of highway-env in its present state.

        Raises
        ------
        ConfigError
            If it is neither.
        SceneError
            If a lane is neither straight nor a sine nor an arc, or the network has no lanes.
        """
        found: Any = source.unwrapped if isinstance(source, gym.Env) else source
        road = found.road.network if isinstance(found, AbstractEnv) else found
        if not isinstance(road, RoadNetwork):
            raise ConfigError(f"have a RoadNetwork or an environment of highway-env, not {type(found).__name__}")
        network, names = network_of(road), tuple(index_of(road))
        if not names:
            raise SceneError("the network has no lanes")
        after = tuple(tuple(int(k) for k in row if k >= 0) for row in continuations_of(road)[0])
        lanes = NetworkLanes(sums_of_numpy()[0], addresses(), network.lanes, network.ids, network.near)
        return cls(names, network, lanes, after, leads_over(road))

    @property
    def widths(self) -> FloatArray:
        """The width of each lane, (n,) [m]."""
        return self.network.lanes[:, LANE_WIDTH].copy()

    @property
    def lengths(self) -> FloatArray:
        """The greatest s on each lane, (n,) [m]."""
        return self.network.lanes[:, LANE_LENGTH].copy()

    def number(self, name: LaneName) -> int:
        """The number of a lane.

        Raises
        ------
        ConfigError
            If no lane has that name.
        """
        try:
            return self.names.index(name)
        except ValueError:
            raise ConfigError(f"there is no lane {name}; have {', '.join(map(str, self.names))}") from None

    def project(self, lane: ArrayLike, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """(s, r) of points on lanes [m]. On an arc, s is within half a circle of 0.

        Raises
        ------
        ConfigError
            If a lane number does not exist, or the shapes do not broadcast.
        """
        s, r = self._filled(project_all, 2, lane, x, y)
        return s, r

    def position(self, lane: ArrayLike, s: ArrayLike, r: ArrayLike = 0.0) -> tuple[FloatArray, FloatArray]:
        """(x, y) of places on lanes [m], beyond their ends and edges too.

        Raises
        ------
        ConfigError
            If a lane number does not exist, or the shapes do not broadcast.
        """
        x, y = self._filled(position_all, 2, lane, s, r)
        return x, y

    def heading(self, lane: ArrayLike, s: ArrayLike) -> FloatArray:
        """Heading of the centre lines at s [rad], not wrapped.

        Raises
        ------
        ConfigError
            If a lane number does not exist, or the shapes do not broadcast.
        """
        return self._filled(heading_all, 1, lane, s)[0]

    def curvature(self, lane: ArrayLike, s: ArrayLike) -> FloatArray:
        """Change of the heading per distance along the centre line [rad/m], positive where it turns right.

        Raises
        ------
        ConfigError
            If a lane number does not exist, or the shapes do not broadcast.
        """
        return self._filled(curvature_all, 1, lane, s)[0]

    def closest(self, x: ArrayLike, y: ArrayLike, heading: ArrayLike) -> Closest:
        """The lanes nearest in position and heading: highway-env's `get_closest_lane_index`.

        Raises
        ------
        ConfigError
            If a number is not finite, or the shapes do not broadcast.
        """
        shape, numbers, (xs, ys, headings) = self._together(0, x, y, heading)
        if not np.isfinite([xs, ys, headings]).all():
            raise ConfigError("have a finite x, y and heading")
        found, s, r = np.empty_like(numbers), np.empty(numbers.size), np.empty(numbers.size)
        closest_all(self.lanes, xs, ys, headings, found, s, r)
        return Closest(found.reshape(shape), s.reshape(shape), r.reshape(shape))

    def successors(self, lane: int) -> tuple[int, ...]:
        """The lanes that follow a lane: of each road that continues it, those that begin within 2.5 m of its end, or
        the nearest.

        Raises
        ------
        ConfigError
            If the lane number does not exist.
        """
        return self.after[self._checked(lane)]

    def neighbours(self, lane: int) -> Neighbours:
        """The lanes next to a lane on its road, in the direction of travel.

        Raises
        ------
        ConfigError
            If the lane number does not exist.
        """
        lane, sides = self._checked(lane), dict[bool, int]()
        own, count = (int(self.network.ids[lane, k]) for k in (ID, COUNT))
        for step in (-1, 1):
            if 0 <= own + step < count:
                x, y = self.position(lane + step, self.lengths[lane + step] / 2)
                sides[bool(self.project(lane, x, y)[1] > 0)] = lane + step
        return Neighbours(sides.get(False), sides.get(True))

    def merges_into(self, lane: int) -> int | None:
        """The neighbouring lane that a vehicle has to change to because a lane ends; None where it continues.

        Raises
        ------
        ConfigError
            If the lane number does not exist.
        """
        over = int(self.over[self._checked(lane)])
        return None if over < 0 else over

    def outline(
        self,
        lane: int,
        first: float = 0.0,
        last: float | None = None,
        low: float | None = None,
        high: float | None = None,
    ) -> FloatArray:
        """Corners of a part of a lane, from `first` to `last` along it and from `low` to `high` across, (k, 2) [m]. By
        default the whole lane. Chords approximate arcs, half a metre apart.

        Raises
        ------
        ConfigError
            If the lane number does not exist.
        """
        lane = self._checked(lane)
        half, end = self.widths[lane] / 2, float(self.lengths[lane]) if last is None else last
        chords = 1 if self.network.ids[lane, SHAPE] == STRAIGHT else max(1, math.ceil((end - first) / _SAMPLE))
        s = np.linspace(first, end, chords + 1)
        r = np.repeat([-half if low is None else low, half if high is None else high], chords + 1)
        return np.column_stack(self.position(lane, np.concatenate([s, s[::-1]]), r))

    def _checked(self, lane: int) -> int:
        """The lane number as an int, checked."""
        return int(self._together(lane)[1][0])

    def _filled(self, kernel: Any, count: int, lane: ArrayLike, *values: ArrayLike) -> list[FloatArray]:
        """Call a kernel of `points` that writes `count` arrays, and return them in the common shape of the
        arguments."""
        shape, numbers, given = self._together(lane, *values)
        written = [np.empty(numbers.size) for _ in range(count)]
        kernel(self.lanes, numbers, *given, *written)
        return [each.reshape(shape) for each in written]

    def _together(self, lane: ArrayLike, *values: ArrayLike) -> tuple[tuple[int, ...], IntArray, list[FloatArray]]:
        """The common shape of the arguments, and each argument broadcast and flattened."""
        numbers: NDArray[Any] = np.asarray(lane)
        wrong = numbers.dtype.kind not in "iu" or bool(((numbers < 0) | (numbers >= len(self.names))).any())
        if wrong:
            raise ConfigError(
                f"lanes have the numbers 0 to {len(self.names) - 1}, not {numbers}; see RoadGeometry.number"
            )
        try:
            given = np.broadcast_arrays(numbers, *(np.asarray(each, float) for each in values))
        except ValueError as error:
            raise ConfigError(f"arrays of numbers that broadcast against one another are needed: {error}") from None
        rows = [np.ascontiguousarray(each).ravel() for each in given]
        return given[0].shape, rows[0].astype(np.int64), rows[1:]
