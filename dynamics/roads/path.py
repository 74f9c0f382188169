r"""Curved roads: parallel lanes along a path of circular arcs and straight pieces, open or closed.

Notation
--------
s [m] is the arc length along the path, r [m] the distance from it, positive towards higher lane indices, k(s) [1/m]
the curvature (piecewise constant, positive where the road turns towards positive r), theta(s) [rad] the direction.
A lane is the line r = constant, so the lanes of a bend are concentric. A closed path comes back to its start after
`length`: s and s + length are the same place, and s is given *near* some reference (see `PathRoad.to_road`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dynamics.errors import SceneError
from dynamics.roads.arcs import Arcs, place, project
from dynamics.roads.bends import Bends
from dynamics.roads.gaps import Gaps
from dynamics.roads.straight import nearest
from dynamics.state import FloatArray, RoadState, State, wrap_to_pi

__all__ = ["CurvatureProfile", "PathRoad"]

_KINK = 1e-6
"""Greatest gap between two pieces, [m] and [rad]."""


@dataclass(frozen=True, slots=True)
class CurvatureProfile:
    """The part of a path that a rollout needs, hashable.

    Attributes
    ----------
    breaks : start of each piece, and end of the last one [m].
    curvatures : of each piece [1/m].
    closed : whether the last piece leads to the first.
    """

    breaks: tuple[float, ...]
    curvatures: tuple[float, ...]
    closed: bool


@dataclass(frozen=True, slots=True, eq=False)
class PathRoad:
    """Parallel lanes of one width along a path without kinks.

    Parameters
    ----------
    pieces : the path.
    centers : lateral position of each lane's centre [m], ascending.
    width : lane width [m].
    closed : whether the path ends where it starts.
    forbidden : lanes that may not be chosen as a target.
    deviation : greatest distance between the centres of a lane here and of the map's lane [m]; 0 if exact.
    gaps : places within the road where the ego's centre is on none of the map's lanes; None without any.

    Attributes
    ----------
    length : length of the path [m].
    profile : its curvature, hashable.

    Raises
    ------
    SceneError
        If the path has a kink, a gap or a piece of half a turn or more, or the lanes reach a centre of curvature.
    """

    pieces: Arcs
    centers: FloatArray
    width: float = 4.0
    closed: bool = False
    forbidden: tuple[bool, ...] = ()
    deviation: float = 0.0
    gaps: Gaps | None = None
    length: float = field(init=False, default=0.0)
    profile: CurvatureProfile = field(init=False, repr=False)
    _bends: Bends = field(init=False, repr=False)
    _starts: FloatArray = field(init=False, repr=False)
    _turn: float = field(init=False, repr=False, default=0.0)
    _middles: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        centers = np.asarray(self.centers, dtype=float)
        p = self.pieces
        if centers.ndim != 1 or centers.size == 0 or not np.all(np.isfinite(centers)) or np.any(np.diff(centers) <= 0):
            raise SceneError(f"lane centres must be a non-empty finite ascending vector, got {self.centers!r}")
        if not self.width > 0:
            raise SceneError(f"the lane width must be positive, got {self.width} m")
        if p.lengths.size == 0 or not np.all(p.lengths > 0) or not np.all(np.isfinite(p.poses)):
            raise SceneError(f"a path needs finite pieces of positive length, got lengths {p.lengths}")
        turns = p.curvatures * p.lengths
        if np.abs(turns).max() >= np.pi + 0.1:
            raise SceneError(f"a piece may turn by at most half a circle, got {np.abs(turns).max():.3f} rad; split it")
        ends = place(p.poses, p.curvatures, p.lengths, 0.0)
        jumps = np.roll(p.poses, -1, axis=0) - ends
        jumps[:, 2] = wrap_to_pi(jumps[:, 2])
        worst = np.abs(jumps if self.closed else jumps[:-1]).max(initial=0.0)
        if worst > _KINK:
            raise SceneError(f"consecutive pieces of a path must meet in place and direction, got a gap of {worst:.3g}")
        edges = np.array([centers[0] - self.width / 2, centers[-1] + self.width / 2])
        if np.max(p.curvatures[:, None] * edges) >= 1:
            raise SceneError(
                f"the lanes (r from {edges[0]:.2f} to {edges[1]:.2f} m) reach the centre of a bend; "
                f"the tightest bends have radii {1 / p.curvatures.max(initial=1e-9):.2f} and "
                f"{1 / p.curvatures.min(initial=-1e-9):.2f} m"
            )
        breaks = np.concatenate([[0.0], np.cumsum(p.lengths)])
        put = object.__setattr__
        put(self, "centers", centers)
        put(self, "forbidden", self.forbidden or (False,) * centers.size)
        put(self, "length", float(breaks[-1]))
        put(self, "profile", CurvatureProfile(tuple(breaks.tolist()), tuple(p.curvatures.tolist()), self.closed))
        k = p.curvatures
        low, high = edges.tolist()
        put(self, "_bends", Bends(min(float(k.min()), 0.0), max(float(k.max()), 0.0), low, high, self.deviation))
        put(self, "_starts", breaks[:-1])
        put(self, "_turn", float(turns.sum()))
        # Projection from the middle of a piece covers an arc up to half a turn before and after it.
        put(self, "_middles", place(p.poses, p.curvatures, p.lengths / 2, 0.0))

    @property
    def bends(self) -> Bends:
        """Bounds over its bends."""
        return self._bends

    def to_road(self, states: FloatArray, near: FloatArray | float | None = None) -> FloatArray:
        """World states (..., 4) to road states (..., 4).

        Parameters
        ----------
        states : world states, shape (..., 4).
        near : on a closed road, s is within half a `length` of this [m], broadcastable to (...); by default s is in [0,
            length).

        Returns
        -------
        Road states; the heading is relative to the path and in [-pi, pi). A point belongs to the piece whose lanes are
        nearest. The first and the last piece of an open path continue before its start and after its end.
        """
        p = self.pieces
        x, y = states[..., State.X, None], states[..., State.Y, None]
        s, r = project(self._middles, p.curvatures, x, y)
        half = p.lengths / 2
        beyond = np.maximum(np.abs(s) - half, 0.0)
        best = np.argmin(np.abs(r - (self.centers[0] + self.centers[-1]) / 2) + beyond, axis=-1)
        s = np.take_along_axis(s, best[..., None], axis=-1)[..., 0]
        out = np.empty((*states.shape[:-1], 4))
        along = s + half[best]
        total = self._starts[best] + along
        if self.closed:
            total = total - self.length * np.floor(
                (total - (0.0 if near is None else near - self.length / 2)) / self.length
            )
        out[..., RoadState.S] = total
        out[..., RoadState.R] = np.take_along_axis(r, best[..., None], axis=-1)[..., 0]
        direction = p.poses[best, 2] + p.curvatures[best] * along
        out[..., RoadState.HEADING] = wrap_to_pi(states[..., State.HEADING] - direction)
        out[..., RoadState.SPEED] = states[..., State.SPEED]
        return out

    def to_world(self, states: FloatArray) -> FloatArray:
        """Road states (..., 4) to world states (..., 4)."""
        piece, along, _ = self._piece(states[..., RoadState.S])
        poses = place(self.pieces.poses[piece], self.pieces.curvatures[piece], along, states[..., RoadState.R])
        out = np.empty((*states.shape[:-1], 4))
        out[..., : State.HEADING] = poses[..., : State.HEADING]
        out[..., State.HEADING] = poses[..., State.HEADING] + states[..., RoadState.HEADING]
        out[..., State.SPEED] = states[..., RoadState.SPEED]
        return out

    def curvature(self, s: FloatArray) -> FloatArray:
        """Curvature of the path [1/m] at arc length s [m], shape of s."""
        found: FloatArray = self.pieces.curvatures[self._piece(s)[0]]
        return found

    def heading(self, s: FloatArray) -> FloatArray:
        """Direction of the path in the world [rad] at arc length s [m], shape of s; each lap adds the turn of a lap."""
        piece, along, laps = self._piece(s)
        found: FloatArray = self.pieces.poses[piece, 2] + self.pieces.curvatures[piece] * along + self._turn * laps
        return found

    def lane_at(self, r: float) -> int:
        """Index of the lane whose centre is nearest to lateral position r [m]."""
        return int(nearest(self.centers, float(r)))

    def reachable(self, s: float, r: float) -> list[bool]:
        """Whether highway-env lets a vehicle at (s, r) [m] choose each lane as a target.

        Source: `AbstractLane.is_reachable_from` in highway-env 1.12; on a closed road every s is within a lane.
        """
        along = self.closed or 0.0 <= s < self.length + 5.0
        return [
            along and not closed and abs(r - float(c)) <= 2 * self.width
            for c, closed in zip(self.centers, self.forbidden, strict=True)
        ]

    def _piece(self, s: FloatArray) -> tuple[Any, FloatArray, FloatArray]:
        """Index of the piece at s [m], the arc length from its start [m], and the laps before it."""
        s = np.asarray(s, dtype=float)
        laps = np.floor(s / self.length) if self.closed else np.zeros_like(s)
        within = s - self.length * laps
        piece = np.clip(np.searchsorted(self._starts, within, side="right") - 1, 0, self._starts.size - 1)
        return piece, within - self._starts[piece], laps
