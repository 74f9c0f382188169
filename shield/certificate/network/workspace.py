"""What a judgement of paths is made from on a network of roads, and the room that it works in."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.road_networks.geometry.lanes import Lanes
from dynamics.road_networks.reachable.strips import FAR, HALF, HIGH, LOW, NEAR, Conduct, Ways
from dynamics.state import BoolArray, FloatArray, IntArray

__all__ = ["Body", "Duty", "Foreseen", "Others", "Road", "Trial", "empty_trial", "foreseen"]

_STANDS = 1e-6
"""Slower is standing [m/s]."""


class Body(NamedTuple):
    """Half length and half width of the ego, and the same with its buffer; how near to a lane's centre it is visible in
    it [m]."""

    length: float
    width: float
    along: float
    across: float
    visible: float


class Duty(NamedTuple):
    """How those behind answer to the ego in their lane: deceleration [m/s^2], frames until then, whether they look
    beyond the end of their lane; and whether those with less right of way answer likewise."""

    braking: float
    reaction: int
    ahead: bool
    gives_way: bool


class Others(NamedTuple):
    """Where the others can be.

    Attributes
    ----------
    rows : vehicle rows, (m, 7). things : rows of what stands, (b, 7).
    marks, numbers : strips, see `dynamics.road_networks.reachable.prediction.spread`; found : how many there are, (1,).
    drive : (m, 5). least, most : (m, K), see `reach`.
    owes : whether each vehicle owes the ego its distance in each lane, (m, n).
    offends : who has broken a rule, (m,).
    gives : for how many frames each vehicle has been counted on to wait for an ego with more right of way before each
        lane, (m, n).
    ranks : the right of way on the way to each strip, (count,). waits : whether a path counts on its vehicle to wait
        before it, (count,), written by `judge`.
    shut : room for whether the ego stands in the way to what comes after a strip, (count,).
    lanes : that have strips. rooms : how far from the centre line of each lane its strips reach, and beyond its ends,
        at most, (n,) [m].
    """

    rows: FloatArray
    things: FloatArray
    marks: IntArray
    numbers: FloatArray
    found: IntArray
    drive: FloatArray
    least: FloatArray
    most: FloatArray
    owes: BoolArray
    offends: BoolArray
    gives: IntArray
    ranks: IntArray
    waits: BoolArray
    shut: BoolArray
    lanes: IntArray
    rooms: FloatArray


class Foreseen(NamedTuple):
    """What a decision has gone by, for m vehicles, k strips and K frames.

    Attributes
    ----------
    rows : vehicle rows of the others, (m, 7). path : the ego in the world after each frame, at rest in the end, (K, 4).
    vehicles, lanes : whose each strip is, and of which lane, (k,).
    least, most : between what s of its lane a body can be at each frame, (k, K) [m]; beyond its ends where it is not
        there. low, high : between what r, (k,) [m].
    waits : whether its vehicle is counted on to wait before it, (k,).
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


class Road(NamedTuple):
    """What is the same in all scenes of an episode: its lanes and circles around them, how much right of way one has in
    each, and who drives on them how."""

    lanes: Lanes
    circles: FloatArray
    rights: IntArray
    ways: Ways
    conduct: Conduct
    duty: Duty
    body: Body
    period: float


class Trial(NamedTuple):
    """Room for what comes of a course, for K frames, n lanes and m vehicles: see `drive`, `survey` and `judge`.

    Attributes
    ----------
    boxes : of the ego with its buffer on each lane, (n, K, 4) [m]. seen : whether it drives in the lane, in its
        direction, where others in it see it, (n, K). met : the first and the last frame in which it is near, (n, 2);
        the last before the first for never. rears : the least s of the body without its buffer at the first and at the
        last place, (n, 2) [m].
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


def empty_trial(frames: int, lanes: int, vehicles: int) -> Trial:
    """Room for paths of so many frames."""
    return Trial(
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


def foreseen(others: Others, trial: Trial, names: list[tuple[str, str, int]]) -> Foreseen:
    """What a decision has gone by, of what `trial` holds; `names` are highway-env's of the lanes."""
    vehicles, lanes, _ = others.marks.T
    numbers, path = others.numbers, trial.path
    stands = np.flatnonzero(np.abs(path[1:, 3]) < _STANDS)
    frames = min(stands[0] + 2 if stands.size else len(path), others.least.shape[1])
    half = numbers[:, HALF]
    return Foreseen(
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
