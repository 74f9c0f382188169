"""Tuples that the judgement of paths on a road network reads, and the buffers that it writes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.road_networks.geometry.lanes import NetworkLanes
from dynamics.road_networks.reachable.strips import BODY_HALF, FAR, HIGH, LOW, NEAR, DrivingBounds, LaneContinuations
from dynamics.state import BoolArray, FloatArray, IntArray

__all__ = [
    "CandidateRollout",
    "EgoExtents",
    "NetworkContext",
    "NetworkFollowerResponse",
    "NetworkPrediction",
    "NetworkVehicles",
    "empty_rollout",
    "prediction_of",
]

_STANDS = 1e-6
"""A slower vehicle counts as standing [m/s]."""


class EgoExtents(NamedTuple):
    """Extents of the ego.

    Attributes
    ----------
    length, width : half length and half width of the body [m].
    along, across : the same with the buffer [m].
    visible : distance from a lane's centre line within which the ego is visible in that lane [m].
    """

    length: float
    width: float
    along: float
    across: float
    visible: float


class NetworkFollowerResponse(NamedTuple):
    """Follower response model: how vehicles behind the ego in its lane brake for it.

    Attributes
    ----------
    braking : deceleration [m/s^2]. reaction : frames until they brake.
    ahead : whether they look beyond the end of their lane.
    gives_way : whether vehicles with less right of way respond to the ego in the same way.
    """

    braking: float
    reaction: int
    ahead: bool
    gives_way: bool


class NetworkVehicles(NamedTuple):
    """Where the other vehicles can be, for m vehicles, b standing bodies, k reachable intervals, n lanes and K frames.

    Attributes
    ----------
    rows : vehicle rows, (m, 7). things : rows of the standing bodies, (b, 7).
    marks, numbers : reachable intervals, (k, 3) and (k, 9), see `dynamics.road_networks.reachable.strips.Strips`.
    found : number of reachable intervals, (1,).
    drive : bounds on the motion of each vehicle, (m, 5). least, most : distances by frame, (m, K) [m]. See
        `dynamics.road_networks.reachable.prediction`.
    obliged : whether each vehicle has a distance obligation in each lane, (m, n).
    offends : violators that the fail-safe has lost its room to, (m,).
    gives : number of frames for which each vehicle has been expected to wait before each lane, for an ego with more
        right of way, (m, n).
    ranks : right of way on the way to each interval, (k,).
    waits : whether the chosen path expects the vehicle to wait before the interval, (k,); written by
        `least_separation`.
    shut : buffer: whether the ego blocks the way to what follows an interval, (k,).
    lanes : indices of the lanes that have intervals.
    rooms : greatest distance that the intervals of each lane extend from its centre line and beyond its ends, (n,) [m].
    """

    rows: FloatArray
    things: FloatArray
    marks: IntArray
    numbers: FloatArray
    found: IntArray
    drive: FloatArray
    least: FloatArray
    most: FloatArray
    obliged: BoolArray
    offends: BoolArray
    gives: IntArray
    ranks: IntArray
    waits: BoolArray
    shut: BoolArray
    lanes: IntArray
    rooms: FloatArray


class NetworkPrediction(NamedTuple):
    """The prediction that a decision was based on, for m vehicles, k reachable intervals and K frames.

    Attributes
    ----------
    rows : vehicle rows of the others, (m, 7).
    path : x, y [m], heading [rad] and speed [m/s] of the ego after each frame, at rest in the end, (K, 4).
    vehicles, lanes : vehicle and lane of each interval, (k,).
    least, most : bounds on s of the body in its lane at each frame, (k, K) [m]; beyond the lane's ends where the body
        is not in the lane.
    low, high : bounds on r, (k,) [m].
    waits : whether the vehicle is expected to wait before the interval, (k,).
    """

    rows: FloatArray
    path: FloatArray
    vehicles: IntArray
    lanes: list[tuple[str, str, int]]
    least: FloatArray
    most: FloatArray
    low: FloatArray
    high: FloatArray
    waits: BoolArray


class NetworkContext(NamedTuple):
    """What is constant in an episode: lanes and assumptions.

    Attributes
    ----------
    lanes : geometry. circles : circle around each lane, (n, 3) [m]. rights : right of way in each lane, (n,).
    ways : which lane leads to which. bounds : bounds on the motion of the others. response : their response to the ego.
    body : extents of the ego. period : duration of a frame [s].
    """

    lanes: NetworkLanes
    circles: FloatArray
    rights: IntArray
    ways: LaneContinuations
    bounds: DrivingBounds
    response: NetworkFollowerResponse
    body: EgoExtents
    period: float


class CandidateRollout(NamedTuple):
    """Rollout buffer of one candidate manoeuvre, for K frames, n lanes and m vehicles; written by
    `simulate_manoeuvre`, `project_path` and `least_separation`.

    Attributes
    ----------
    path : x, y [m], heading [rad] and speed [m/s] of the ego, (K + 1, 4).
    first : acceleration [m/s^2] and front wheel angle [rad] in the first frame, (2,).
    bound, own : target lane and own lane of the ego in each frame, (K + 1,).
    boxes : extents of the ego with its buffer on each lane, (n, K + 1, 4) [m].
    seen : whether the ego drives in the lane and in its direction, so that other vehicles there see it, (n, K + 1).
    met : first and last frame in which the ego is near the lane, (n, 2); the last is before the first if there is none.
    rears : least s of the body without its buffer, at the first and at the last place, (n, 2) [m].
    margins : least separation from each vehicle, (m,) [m].
    """

    path: FloatArray
    first: FloatArray
    bound: IntArray
    own: IntArray
    boxes: FloatArray
    seen: BoolArray
    met: IntArray
    rears: FloatArray
    margins: FloatArray


def empty_rollout(frames: int, lanes: int, vehicles: int) -> CandidateRollout:
    """Rollout buffer for paths of at most `frames` frames."""
    return CandidateRollout(
        np.zeros((frames + 1, 4)),
        np.zeros(2),
        np.zeros(frames + 1, np.int64),
        np.zeros(frames + 1, np.int64),
        np.zeros((lanes, frames + 1, 4)),
        np.zeros((lanes, frames + 1), np.bool_),
        np.zeros((lanes, 2), np.int64),
        np.zeros((lanes, 2)),
        np.zeros(vehicles),
    )


def prediction_of(
    others: NetworkVehicles, rollout: CandidateRollout, names: list[tuple[str, str, int]]
) -> NetworkPrediction:
    """The prediction behind a decision, from the rollout buffer of its path; `names` are highway-env's names of the
    lanes."""
    vehicles, lanes, _ = others.marks.T
    numbers, path = others.numbers, rollout.path
    stands = np.flatnonzero(np.abs(path[1:, 3]) < _STANDS)
    frames = min(stands[0] + 2 if stands.size else len(path), others.least.shape[1])
    half = numbers[:, BODY_HALF]
    return NetworkPrediction(
        rows=others.rows.copy(),
        path=path[:frames].copy(),
        vehicles=vehicles.copy(),
        lanes=[names[k] for k in lanes],
        least=others.least[vehicles, :frames] - (numbers[:, FAR] + half)[:, None],
        most=others.most[vehicles, :frames] - (numbers[:, NEAR] - half)[:, None],
        low=numbers[:, LOW].copy(),
        high=numbers[:, HIGH].copy(),
        waits=others.waits.copy(),
    )
