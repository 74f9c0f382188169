"""Result of an assignment of observed vehicles to tracks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.compiled import kernel_no_refcount
from dynamics.state import BoolArray, FloatArray, IntArray

__all__ = ["Assignment", "apply_gate"]


class Assignment(NamedTuple):
    """Assignment of m observed vehicles to n tracks.

    Attributes
    ----------
    rows, columns : tracks and observed vehicles that match, (k,) and (k,).
    missed, places, seen, innovation : of the tracks, see `tracking.Tracks`.
    unknown : which observed vehicles have no track, (m,).
    whole : whether every observed vehicle has a track, and no track has been missed for too long.
    """

    rows: IntArray
    columns: IntArray
    missed: IntArray
    places: FloatArray
    seen: FloatArray
    innovation: FloatArray
    unknown: BoolArray
    whole: bool


def apply_gate(
    rows: IntArray,
    columns: IntArray,
    apart: FloatArray,
    gate: float,
    patience: int,
    missed: IntArray,
    places: FloatArray,
    before: FloatArray,
    at: FloatArray,
    seen: FloatArray,
) -> Assignment:
    """Apply the gate to an assignment of tracks `rows` (l,) to observed vehicles `columns` (l,).

    Parameters
    ----------
    apart : squared distance of each pair, (l,). gate : greatest squared distance of a match.
    patience : consecutive observations that a vehicle may be missing from. missed, places, before : see
        `tracking.Tracks`; `before` is `Tracks.seen`.
    at, seen : rows (m,) and states (m, 4) of the observed vehicles.
    """
    pairs, missed, places, shown = np.empty((2, len(rows)), np.intp), missed + 1, places.copy(), before.copy()
    innovation, unknown = np.empty(len(missed)), np.empty(len(at), np.bool_)
    found = missed, places, shown, innovation, unknown
    count, whole = _settle(rows, columns, apart, gate, patience, at, seen, pairs, *found)
    return Assignment(pairs[0, :count], pairs[1, :count], *found, whole)


@kernel_no_refcount
def _settle(
    rows: IntArray,
    columns: IntArray,
    apart: FloatArray,
    gate: float,
    patience: int,
    at: FloatArray,
    seen: FloatArray,
    pairs: IntArray,
    missed: IntArray,
    places: FloatArray,
    shown: FloatArray,
    innovation: FloatArray,
    unknown: BoolArray,
) -> tuple[int, bool]:
    """Fill in the pairs, (2, l), and the values of each track and observed vehicle. Returns the number of pairs, and
    `Assignment.whole`."""
    count, whole = 0, True
    for a in range(len(missed)):
        innovation[a] = np.nan
    for b in range(len(unknown)):
        unknown[b] = True
    for pair in range(len(rows)):
        a, b = rows[pair], columns[pair]
        if not apart[pair] <= gate:
            continue
        pairs[0, count], pairs[1, count] = a, b
        count += 1
        innovation[a], missed[a], places[a], unknown[b] = apart[pair], 0, at[b], False
        for k in range(4):
            shown[a, k] = seen[b, k]
    for a in range(len(missed)):
        whole = whole and missed[a] <= patience
    for b in range(len(unknown)):
        whole = whole and not unknown[b]
    return count, whole
