"""Roads as arc-length paths: projection to (s, r) and back, batched.

Decisions use road coordinates only. `Road` is the interface of all roads; `StraightRoad` is the multi-lane straight
road of `highway-v0` and `highway-fast-v0`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from dynamics.compiled import kernel_no_refcount
from dynamics.errors import SceneError
from dynamics.roads.gaps import Gaps
from dynamics.state import FloatArray, RoadState, State

__all__ = ["Road", "StraightRoad", "nearest"]

_X, _Y, _HEADING, _SPEED = int(State.X), int(State.Y), int(State.HEADING), int(State.SPEED)
_S, _R, _PSI, _V = int(RoadState.S), int(RoadState.R), int(RoadState.HEADING), int(RoadState.SPEED)


class Road(Protocol):
    """Parallel lanes along one reference path.

    Attributes
    ----------
    centers : lateral position r of each lane's centre [m], shape (lanes,), ascending.
    width : lane width [m].
    length : length of the path [m].
    forbidden : whether each lane may not be chosen as a target.
    """

    @property
    def centers(self) -> FloatArray: ...

    @property
    def width(self) -> float: ...

    @property
    def length(self) -> float: ...

    @property
    def forbidden(self) -> tuple[bool, ...]: ...

    @property
    def bends(self) -> Any:
        """Bounds over its bends (`dynamics.roads.bends.Bends`), None on a straight road."""
        ...

    @property
    def gaps(self) -> Gaps | None:
        """Strips within the road that belong to no lane of its map; None without any."""
        ...

    def to_road(self, states: FloatArray, near: FloatArray | float | None = None) -> FloatArray:
        """World states (..., 4) to road states (..., 4); on a closed road, with s within half a lap of `near` [m]."""
        ...

    def to_world(self, states: FloatArray) -> FloatArray:
        """Road states (..., 4) to world states (..., 4)."""
        ...

    def curvature(self, s: FloatArray) -> FloatArray:
        """Curvature of the reference path [1/m] at arc length s [m]."""
        ...

    def lane_at(self, r: float) -> int:
        """Index of the lane whose centre is nearest to lateral position r [m]."""
        ...

    def reachable(self, s: float, r: float) -> list[bool]:
        """Whether highway-env lets a vehicle at (s, r) [m] choose each lane as a target."""
        ...


@kernel_no_refcount
def _to_road(states: Any, x: float, y: float, cos: float, sin: float, heading: float, out: Any) -> None:
    """World states (n, 4) to road states, `out` (n, 4), by the origin and the heading of the road."""
    for i in range(states.shape[0]):
        dx, dy = states[i, _X] - x, states[i, _Y] - y
        out[i, _S], out[i, _R] = cos * dx + sin * dy, cos * dy - sin * dx
        out[i, _PSI], out[i, _V] = states[i, _HEADING] - heading, states[i, _SPEED]


@kernel_no_refcount
def _to_world(states: Any, x: float, y: float, cos: float, sin: float, heading: float, out: Any) -> None:
    """Road states (n, 4) to world states, `out` (n, 4), by the origin and the heading of the road."""
    for i in range(states.shape[0]):
        s, r = states[i, _S], states[i, _R]
        out[i, _X], out[i, _Y] = x + cos * s - sin * r, y + sin * s + cos * r
        out[i, _HEADING], out[i, _SPEED] = states[i, _PSI] + heading, states[i, _V]


@kernel_no_refcount
def nearest(centers: Any, r: float) -> int:
    """Index of the centre that is nearest to r, the first among equals."""
    best = 0
    for j in range(1, centers.shape[0]):
        if abs(centers[j] - r) < abs(centers[best] - r):
            best = j
    return best


@dataclass(frozen=True, slots=True)
class StraightRoad:
    """Straight parallel lanes of one width.

    Parameters
    ----------
    centers : lateral position of each lane's centre [m], ascending.
    width : lane width [m].
    length : length of the road [m].
    origin : world position of (s, r) = (0, 0) [m].
    heading : direction of the road in the world [rad].

    Raises
    ------
    SceneError
        If the centres are not ascending or a size is not positive.
    """

    centers: FloatArray
    width: float = 4.0
    length: float = 10_000.0
    origin: tuple[float, float] = (0.0, 0.0)
    heading: float = 0.0
    forbidden: tuple[bool, ...] = ()
    _cos: float = field(init=False, repr=False, default=1.0)
    _sin: float = field(init=False, repr=False, default=0.0)

    def __post_init__(self) -> None:
        centers = np.asarray(self.centers, dtype=float)
        if centers.ndim != 1 or centers.size == 0 or not np.all(np.isfinite(centers)):
            raise SceneError(f"lane centres must be a non-empty finite vector, got {self.centers!r}")
        if np.any(np.diff(centers) <= 0):
            raise SceneError(f"lane centres must ascend, got {centers}")
        if not (self.width > 0 and self.length > 0):
            raise SceneError(f"width and length must be positive, got {self.width} m and {self.length} m")
        object.__setattr__(self, "centers", centers)
        object.__setattr__(self, "forbidden", self.forbidden or (False,) * centers.size)
        object.__setattr__(self, "_cos", float(np.cos(self.heading)))
        object.__setattr__(self, "_sin", float(np.sin(self.heading)))

    @classmethod
    def from_lanes(cls, lanes: int, width: float = 4.0, **kwargs: Any) -> StraightRoad:
        """The straight road that highway-env builds: lane i is centred at r = i * width."""
        return cls(centers=np.arange(lanes, dtype=np.float64) * width, width=width, **kwargs)

    @classmethod
    def from_network(cls, network: Any) -> StraightRoad:
        """Read a highway-env `RoadNetwork`.

        Raises
        ------
        SceneError
            If the network is not one road of straight parallel lanes of equal width.
        """
        roads = [(a, b, lanes) for a, to in network.graph.items() for b, lanes in to.items()]
        names = [f"{a}->{b}" for a, b, _ in roads]
        if len(roads) != 1:
            raise SceneError(
                f"the shield supports one road of straight parallel lanes (highway-v0, highway-fast-v0); this network "
                f"has {len(roads)} roads: {', '.join(names[:6])}"
            )
        lanes = roads[0][2]
        if any(type(lane).__name__ != "StraightLane" for lane in lanes):
            kinds = sorted({type(lane).__name__ for lane in lanes})
            raise SceneError(f"the shield supports StraightLane only; road {names[0]} has {kinds}")
        first = lanes[0]
        centers = [float((lane.start - first.start) @ first.direction_lateral) for lane in lanes]
        starts = [float((lane.start - first.start) @ first.direction) for lane in lanes]
        headings = [abs(float(lane.heading - first.heading)) for lane in lanes]
        widths = {float(lane.width) for lane in lanes}
        if max(map(abs, starts)) > 1e-6 or max(headings) > 1e-9 or len(widths) != 1:
            raise SceneError(
                f"the lanes of road {names[0]} must be parallel, aligned and of one width; "
                f"widths {sorted(widths)}, heading differences up to {max(headings):.3g} rad"
            )
        return cls(
            centers=np.array(centers),
            width=widths.pop(),
            length=float(first.length),
            origin=(float(first.start[0]), float(first.start[1])),
            heading=float(first.heading),
            forbidden=tuple(bool(lane.forbidden) for lane in lanes),
        )

    @property
    def bends(self) -> None:
        """None: there are no bends."""

    @property
    def gaps(self) -> None:
        """None: parallel lanes of one width have no gaps."""

    def to_road(self, states: FloatArray, near: FloatArray | float | None = None) -> FloatArray:
        """World states (..., 4) to road states (..., 4); a straight road has no laps, so `near` has no effect."""
        rows = np.ascontiguousarray(states, float).reshape(-1, states.shape[-1])
        out = np.empty((*states.shape[:-1], 4))
        _to_road(rows, *self.origin, self._cos, self._sin, self.heading, out.reshape(-1, 4))
        return out

    def to_world(self, states: FloatArray) -> FloatArray:
        """Road states (..., 4) to world states (..., 4)."""
        rows = np.ascontiguousarray(states, float).reshape(-1, states.shape[-1])
        out = np.empty((*states.shape[:-1], 4))
        _to_world(rows, *self.origin, self._cos, self._sin, self.heading, out.reshape(-1, 4))
        return out

    def curvature(self, s: FloatArray) -> FloatArray:
        """Zero everywhere [1/m]."""
        return np.zeros_like(s)

    def lane_at(self, r: float) -> int:
        """Index of the lane whose centre is nearest to lateral position r [m]."""
        return int(nearest(self.centers, float(r)))

    def reachable(self, s: float, r: float) -> list[bool]:
        """Whether highway-env lets a vehicle at (s, r) [m] choose each lane as a target.

        Source: `AbstractLane.is_reachable_from` in highway-env 1.12.
        """
        along = 0.0 <= s < self.length + 5.0
        return [
            along and not closed and abs(r - float(c)) <= 2 * self.width
            for c, closed in zip(self.centers, self.forbidden, strict=True)
        ]
