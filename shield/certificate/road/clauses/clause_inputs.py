"""Inputs that several clauses share: the ego, a path, and the lanes."""

from __future__ import annotations

from typing import NamedTuple

from dynamics.state import BoolArray, FloatArray, IntArray

__all__ = ["EarlierVehicles", "EgoArrays", "LaneDistances", "LaneState", "PlannedPath"]


class EgoArrays(NamedTuple):
    """The ego in a scene: vehicle row (7,), road state (4,), numbers of its `Footprint` (8,)."""

    vehicle: FloatArray
    state: FloatArray
    size: FloatArray


class PlannedPath(NamedTuple):
    """A path of the ego.

    Attributes
    ----------
    path : road states after each frame, (K, 4).
    turned : sine and cosine of the headings, (2, at least K).
    lane, fail : lanes that the path commits to and stops in.
    """

    path: FloatArray
    turned: FloatArray
    lane: int
    fail: int


class LaneState(NamedTuple):
    """Lanes of a scene.

    Attributes
    ----------
    centers : (lanes,) [m]. owned : whether the ego owns each, (lanes,).
    visible : number of frames for which it has been visible in each, (lanes,).
    """

    centers: FloatArray
    owned: BoolArray
    visible: IntArray


class LaneDistances(NamedTuple):
    """Distances from a lane's centre that decide about visibility and ownership [m].

    Attributes
    ----------
    sight : within which the ego is visible in the lane.
    touch, leave : within which it touches the lane, and has not left it with its whole body.
    """

    sight: float
    touch: float
    leave: float


class EarlierVehicles(NamedTuple):
    """The other vehicles in the scene before.

    Attributes
    ----------
    followers : vehicles that had a distance obligation, (m,) bool; empty if there was none.
    comes : `RoadVehicles.comes`, (lanes, m); of another shape if there was none.
    """

    followers: BoolArray
    comes: BoolArray
