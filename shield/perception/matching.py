"""Result of an assignment of observed vehicles to tracks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.compiled import kernel_no_refcount
from dynamics.state import BoolArray, FloatArray, IntArray

__all__ = ["Assignment", "CandidatePairs", "LastObservation", "ObservedVehicles", "apply_gate"]


class CandidatePairs(NamedTuple):
    """Pairs of tracks and observed vehicles, before the gate.

    Attributes
    ----------
    rows, columns : tracks and observed vehicles, (l,). apart : squared distance of each pair, (l,).
    """

    rows: IntArray
    columns: IntArray
    apart: FloatArray


class LastObservation(NamedTuple):
    """`missed`, `places` and `seen` of `tracking.Tracks`."""

    missed: IntArray
    places: FloatArray
    seen: FloatArray


class ObservedVehicles(NamedTuple):
    """Rows (m,) and states (m, 4) of the observed vehicles."""

    at: FloatArray
    seen: FloatArray


class _Found(NamedTuple):
    """Arrays that `_settle` writes: pairs (2, l), and fields of `Assignment`."""

    pairs: IntArray
    missed: IntArray
    places: FloatArray
    seen: FloatArray
    innovation: FloatArray
    unknown: BoolArray


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
    pairs: CandidatePairs, gate: float, missed_limit: int, last: LastObservation, observed: ObservedVehicles
) -> Assignment:
    """Apply the gate to an assignment of tracks to observed vehicles.

    Parameters
    ----------
    gate : greatest squared distance of a match.
    missed_limit : consecutive observations that a vehicle may be missing from. last : of the tracks.
    """
    kept, innovation = np.empty((2, len(pairs.rows)), np.intp), np.empty(len(last.missed))
    unknown = np.empty(len(observed.at), np.bool_)
    found = _Found(kept, last.missed + 1, last.places.copy(), last.seen.copy(), innovation, unknown)
    count, whole = _settle(pairs, gate, missed_limit, observed, found)
    return Assignment(kept[0, :count], kept[1, :count], *found[1:], whole)


@kernel_no_refcount
def _settle(
    candidates: CandidatePairs, gate: float, missed_limit: int, observed: ObservedVehicles, found: _Found
) -> tuple[int, bool]:
    """Fill in the pairs, and the values of each track and observed vehicle. Return the number of pairs, and
    `Assignment.whole`."""
    rows, columns, apart = candidates
    at, seen = observed
    pairs, missed, places, shown, innovation, unknown = found
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
        whole = whole and missed[a] <= missed_limit
    for b in range(len(unknown)):
        whole = whole and not unknown[b]
    return count, whole
