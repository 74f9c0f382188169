"""The clause of room: a plan stops inside one lane; and the margin that comes of all clauses."""

from __future__ import annotations

import math

import numpy as np

from dynamics.compiled import uncounted
from dynamics.state import FloatArray, IntArray
from shield.certificate.clauses.footprint import Footprint

__all__ = ["margins", "rooms"]


@uncounted
def rooms(
    paths: FloatArray,
    size: Footprint,
    centers: FloatArray,
    fails: IntArray,
    side: float,
    bent: bool,
    out: FloatArray,
) -> None:
    """What is left beside the ego with its buffer in the lane that each path stops in, `out` (n,) [m]; negative where
    it reaches out. `size` as in `least_separations`."""
    last = paths.shape[1] - 1
    for i in range(paths.shape[0]):
        r, psi = paths[i, last, 1], paths[i, last, 2]
        sin, cos = abs(math.sin(psi)), abs(math.cos(psi))
        # On a bend, what lies ahead and behind in the lane bends with the road: only the body has to fit.
        half = (
            0.5 * size.length * sin + size.across * cos + size.bare_across
            if bent
            else size.along * sin + size.across * cos
        )
        out[i] = side - abs(r - centers[fails[i]]) - half


@uncounted
def margins(separations: FloatArray, slipping: FloatArray, room: FloatArray, out: FloatArray) -> None:
    """The least separation of each path, and what it lacks of room where it does, `out` (n,) [m]; NaN where anything
    is.

    Parameters
    ----------
    separations, slipping : from vehicles in reach (n, m), and from those that may slip in (n, q) [m]. room : (n,) [m].
    """
    for i in range(room.shape[0]):
        least, known = np.inf, not math.isnan(room[i])
        if room[i] < 0:
            least = room[i]
        for j in range(separations.shape[1]):
            known = known and not math.isnan(separations[i, j])
            least = min(least, separations[i, j])
        for j in range(slipping.shape[1]):
            known = known and not math.isnan(slipping[i, j])
            least = min(least, slipping[i, j])
        out[i] = least if known else np.nan
