"""What the judgement of a path has before it: the ground, the others, and room to write on."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import compiled
from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.traffic.tables import Bodies, Motion
from shield.certificate.road.clauses.cut_in import LASTS
from shield.certificate.road.clauses.others import Others

__all__ = ["Around", "Desk", "Ground", "new_desk"]


class Ground(NamedTuple):
    """Centres of the lanes [m], which of them the ego owns, and for how many frames it has been visible in each."""

    centers: FloatArray
    owned: BoolArray
    visible: IntArray


class Around(NamedTuple):
    """The others of a scene: `rows` (m, 7), `states` (m, 4), what a metre driven is of the road, `stretch` (2, m or 0),
    `bodies`, `motion` and `others`."""

    rows: FloatArray
    states: FloatArray
    stretch: FloatArray
    bodies: Bodies
    motion: Motion
    others: Others


class Desk(NamedTuple):
    """Room for the judgement of one path of up to K frames among m vehicles, and what is known from the last one in the
    same scene.

    Attributes
    ----------
    near : the vehicles in reach, (m,), of which there are `found` (1,). sides : where each can be across the road,
        (2, m) [m], and `home` (m,): its lane. apart : separation from each, (m,) [m].
    rears : least s of each vehicle (by row), (2, m, K) [m], as a bound and as a forecast; `done` (2, m): of how many
        frames, 0 in a new scene. rear : of one of those in reach, (1, K).
    turned : sine and cosine of the path's headings, (2, K). bounds : of the ego, (5, K). room : (1,) [m].
    slipping, slips, ways, sweep, turns, away : of those that may slip in, (2 m,), (6, 2 m), (2, 2 m, K), (2 m, T, 2),
        (2 m, T, 4) and (2 m,). swept : for how many frames these are known, (1,); 0 in a new scene.
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
    slipping: IntArray
    slips: FloatArray
    ways: FloatArray
    sweep: FloatArray
    turns: FloatArray
    away: FloatArray
    swept: IntArray


@compiled
def new_desk(m: int, frames: int, dt: float) -> Desk:
    """An empty one."""
    last = math.ceil(LASTS / dt)
    return Desk(
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
