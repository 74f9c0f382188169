"""Inputs of the clauses, and their workspace."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import compiled
from dynamics.state import FloatArray, IntArray
from dynamics.traffic.tables import Motion, ReachableBodies
from shield.certificate.road.clauses.clause_inputs import LaneState
from shield.certificate.road.clauses.cut_in import CUT_IN_DURATION
from shield.certificate.road.clauses.footprint import Footprint
from shield.certificate.road.clauses.others import RoadVehicles
from shield.certificate.road.clauses.parameters import ClauseSettings

__all__ = ["ClauseScene", "ClauseWorkspace", "SceneVehicles", "new_clause_workspace"]


class SceneVehicles(NamedTuple):
    """The other vehicles of a scene.

    Attributes
    ----------
    rows : vehicle rows, (m, 7). states : road states, (m, 4).
    stretch : distance along the road for each metre driven, (2, m), or (2, 0) on a straight road.
    bodies, motion, others : reachable places, bounds on the motion, and the vehicles as the clauses read them.
    """

    rows: FloatArray
    states: FloatArray
    stretch: FloatArray
    bodies: ReachableBodies
    motion: Motion
    others: RoadVehicles


class ClauseScene(NamedTuple):
    """A scene as the clauses read it.

    Attributes
    ----------
    state : road state of the ego now, (4,). around, ground : the other vehicles and the lanes.
    cutting_in : candidates for a cut-in, (c, 4), see `find_cut_ins`.
    foot : footprint of the ego. settings : of the clauses.
    table : of the road, see `dynamics.vehicle.rollout_kernels`.
    """

    state: FloatArray
    around: SceneVehicles
    ground: LaneState
    cutting_in: FloatArray
    foot: Footprint
    settings: ClauseSettings
    table: FloatArray


class ClauseWorkspace(NamedTuple):
    """Workspace for one path of at most K frames among m vehicles, with the values that further paths of the same scene
    reuse.

    Attributes
    ----------
    near : rows of the vehicles in reach, (m,); `found` of them, (1,). apart : separation from each, (m,) [m].
    sides : lateral extents of each, (2, m) [m]. home : its lane, (m,).
    rears : least s of each vehicle (by row) as a bound and as a forecast, (2, m, K) [m].
    done : number of frames for which `rears` is valid, (2, m); 0 in a new scene.
    rear : least s of one vehicle in reach, (1, K) [m].
    turned : sine and cosine of the path's headings, (2, K). bounds : extents of the ego, and a buffer, (5, K) [m].
    room : in the lane that the path stops in, (1,) [m].
    cutting_in, cut_ins : rows, (2 m,), and numbers, (6, 2 m), of the vehicles that may cut in.
    ways : their least and greatest s, (2, 2 m, K) [m]. sweep : their lateral extents, (2 m, T, 2) [m].
    turns : buffer, (2 m, T, 4). away : separation from each, (2 m,) [m].
    swept : number of frames for which these are valid, (1,); 0 in a new scene.
    """

    near: IntArray
    found: IntArray
    sides: FloatArray
    home: IntArray
    apart: FloatArray
    rears: FloatArray
    done: IntArray
    rear: FloatArray
    turned: FloatArray
    bounds: FloatArray
    room: FloatArray
    cutting_in: IntArray
    cut_ins: FloatArray
    ways: FloatArray
    sweep: FloatArray
    turns: FloatArray
    away: FloatArray
    swept: IntArray


@compiled
def new_clause_workspace(m: int, frames: int, dt: float) -> ClauseWorkspace:
    """An empty workspace for `m` vehicles and paths of at most `frames` frames of duration `dt` [s]."""
    last = math.ceil(CUT_IN_DURATION / dt)
    return ClauseWorkspace(
        np.empty(m, np.intp),
        np.zeros(1, np.intp),
        np.empty((2, m)),
        np.empty(m, np.intp),
        np.empty(m),
        np.empty((2, m, frames)),
        np.zeros((2, m), np.intp),
        np.empty((1, frames)),
        np.empty((2, frames)),
        np.empty((5, frames)),
        np.empty(1),
        np.empty(2 * m, np.intp),
        np.empty((6, 2 * m)),
        np.empty((2, 2 * m, frames)),
        np.empty((2 * m, last, 2)),
        np.empty((2 * m, last, 4)),
        np.empty(2 * m),
        np.zeros(1, np.intp),
    )
