"""What the assignment of those who are seen to those who are followed comes to."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.compiled import uncounted
from dynamics.state import BoolArray, FloatArray, IntArray

__all__ = ["Settled", "settled"]


class Settled(NamedTuple):
    """Who is whom of n that are followed and m that are seen.

    Attributes
    ----------
    rows, columns : of those who are both, (k,) and (k,).
    missed, places, seen, innovation : of those who are followed, see `tracking.Tracks`.
    unknown : who of those seen is new, (m,).
    whole : whether nobody is new, and nobody missing for too long.
    """

    rows: IntArray
    columns: IntArray
    missed: IntArray
    places: FloatArray
    seen: FloatArray
    innovation: FloatArray
    unknown: BoolArray
    whole: bool


def settled(
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
) -> Settled:
    """What an assignment comes to: of `rows` (l,) to `columns` (l,), so far `apart`, (l,); beyond the gate
    they are not the same.

    Parameters
    ----------
    patience : for how many observations somebody may be missing. missed, places, before : as of `tracking.Tracks`.
    at, seen : rows (m,) and states (m, 4) of those who are seen.
    """
    pairs, missed, places, shown = np.empty((2, len(rows)), np.intp), missed + 1, places.copy(), before.copy()
    innovation, unknown = np.empty(len(missed)), np.empty(len(at), np.bool_)
    found = missed, places, shown, innovation, unknown
    count, whole = _settle(rows, columns, apart, gate, patience, at, seen, pairs, *found)
    return Settled(pairs[0, :count], pairs[1, :count], *found, whole)


@uncounted
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
    """Fill in the pairs, (2, l), and what is known of each; how many pairs there are, and `Settled.whole`."""
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
