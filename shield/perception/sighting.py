"""Decoding of a Kinematics observation, into metres and the world frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from dynamics.compiled import kernel_no_refcount
from dynamics.state import BoolArray, FloatArray, IntArray
from shield.errors import SceneError
from shield.perception.spec import STATE, ObservationSpec

__all__ = ["DecodedObservation", "decode", "numbers_of"]

_EDGE = 1.0 - 1e-6
"""A normalised and clipped number of at least this may stand for any value beyond its range."""
_FULL = 1e-3
"""Without a presence column, a row is empty if all its numbers are smaller than this."""
_NAMED = ("presence", "cos_h", "sin_h", "heading")
"""Features beside the state that are read here."""


@dataclass(frozen=True, slots=True, eq=False)
class DecodedObservation:
    """One decoded observation.

    Attributes
    ----------
    ego : x, y [m], vx, vy [m/s] of the ego, (4,); x is NaN where it has left its range.
    others : the same of the other vehicles, (m, 4): x relative to the ego, y, vx and vy absolute.
    heading : of the ego [rad]; NaN where it is not a feature.
    places : row index of each of the others, (m,).
    full : whether no row is empty; then more vehicles may exist than the observation shows.
    cut : whether a row is clipped: a vehicle exists, and its position is unknown. Rows beyond a range of x that ends
        before the ego's sight are out of sight, and do not count.
    """

    ego: FloatArray
    others: FloatArray
    heading: float
    places: IntArray
    full: bool
    cut: bool


def decode(spec: ObservationSpec, observation: object) -> DecodedObservation:
    """Decode an observation.

    Parameters
    ----------
    observation : of shape `spec.shape`, or the same flattened.

    Raises
    ------
    SceneError
        If it is not an array of real numbers, has another shape, is not finite, or does not show the ego.
    """
    rows = numbers_of(observation, spec.shape)
    low, half, ranged, where, named = _layout(spec.features, tuple(spec.ranges.items()))  # type: ignore[union-attr]
    n = len(rows)
    ego_row, states, places = np.empty(rows.shape[1]), np.empty((n, len(STATE))), np.empty(n, np.intp)
    columns = _Columns(low, half, ranged, where, named[0], spec.clip, spec.absolute)
    shown, known, lost = _read(rows, columns, _Decoded(ego_row, states, places))
    if not shown:
        raise SceneError("the observation does not show the ego: its first row is empty")
    if lost & ~1:
        names = [name for k, name in enumerate(STATE) if k and lost & (1 << k)]
        raise SceneError(f"the ego's {', '.join(names)} is at the edge of its range, and so unknown")
    ego, others = states[0], states[1:known]
    cut = known < shown and known + _out_of_sight(spec, rows, named[0], int(where[0])) < shown
    return DecodedObservation(ego, others, _heading(named, ego_row), places[1:known], shown == n, cut)


def _out_of_sight(spec: ObservationSpec, rows: FloatArray, presence: int, column: int) -> int:
    """Number of rows that are clipped at a bound of x nearer than the ego's sight; these count as out of sight."""
    if spec.absolute or "x" not in spec.ranges:  # type: ignore[operator]
        return 0
    low, high = spec.ranges["x"]  # type: ignore[index]
    there = rows[:, presence] > 0.5 if presence >= 0 else np.abs(rows).max(axis=1) > _FULL
    ahead = (rows[:, column] >= _EDGE) & (high < spec.distance)
    behind = (rows[:, column] <= -_EDGE) & (-low < spec.distance)
    return int((there & (ahead | behind))[1:].sum())


class _Columns(NamedTuple):
    """Columns of an observation.

    Attributes
    ----------
    low, half, ranged : for each feature the lower end of its range, half the width of the range, and whether it has a
        range. where : columns of the state, (4,).
    presence : its column, or -1. clip, absolute : see `ObservationSpec`.
    """

    low: FloatArray
    half: FloatArray
    ranged: BoolArray
    where: IntArray
    presence: int
    clip: bool
    absolute: bool


class _Decoded(NamedTuple):
    """Arrays that `_read` writes: the ego's row (features,) in its units; and for the ego and each vehicle with a known
    position its state (n, 4) and its row index (n,)."""

    ego_row: FloatArray
    states: FloatArray
    places: IntArray


@kernel_no_refcount
def _read(rows: FloatArray, columns: _Columns, out: _Decoded) -> tuple[int, int, int]:
    """Decode observed rows (n, features) to `out`.

    Returns
    -------
    The number of rows shown (0 without the ego), the number of filled results, and a bit for each clipped component of
    the ego's state.
    """
    low, half, ranged, where, presence, clip, absolute = columns
    ego_row, states, places = out
    shown, known, lost = 0, 0, 0
    for i in range(rows.shape[0]):
        there = i == 0
        if presence >= 0:
            there = rows[i, presence] > 0.5
        else:
            for k in range(rows.shape[1]):
                there = there or abs(rows[i, k]) > _FULL
        if not there:
            if i == 0:
                return 0, 0, 0
            continue
        shown, at_edge = shown + 1, 0
        for c in range(where.shape[0]):
            k = where[c]
            number = rows[i, k]
            states[known, c] = low[k] + (number + 1.0) * half[k] if ranged[k] else number
            if clip and ranged[k] and abs(number) >= _EDGE:
                at_edge |= 1 << c
        if i == 0:
            lost, known = at_edge, 1
            for k in range(rows.shape[1]):
                ego_row[k] = low[k] + (rows[0, k] + 1.0) * half[k] if ranged[k] else rows[0, k]
            continue
        if at_edge:
            continue
        if absolute:
            states[known, 0] -= states[0, 0]
        else:
            for c in range(1, where.shape[0]):
                states[known, c] += states[0, c]
        places[known] = i
        known += 1
    if lost & 1:
        states[0, 0] = np.nan
    return shown, known, lost


def numbers_of(observation: object, shape: tuple[int, ...]) -> FloatArray:
    """Observation as 64-bit numbers of the given shape.

    Raises
    ------
    SceneError
        If it is not an array of real numbers, has neither this shape nor the same flattened, or is not finite.
    """
    try:
        given = np.asarray(observation)
    except (TypeError, ValueError):
        given = np.array(None)
    if given.dtype.kind not in "fiu":
        raise SceneError(f"an observation is an array of real numbers, not {_kind(observation, given)}")
    if given.shape not in (shape, (math.prod(shape),)):
        raise SceneError(f"an observation of shape {shape} is expected, got {given.shape}")
    rows: FloatArray = given.reshape(shape).astype(np.float64)
    if not np.isfinite(rows).all():
        raise SceneError("the observation is not finite")
    return rows


def _kind(observation: object, given: Any) -> str:
    """Description of an unsuitable observation, for a message."""
    return f"of {given.dtype}" if given.ndim else type(observation).__name__


@lru_cache(maxsize=16)
def _layout(
    features: tuple[str, ...], ranges: tuple[tuple[str, tuple[float, float]], ...]
) -> tuple[FloatArray, FloatArray, BoolArray, IntArray, tuple[int, ...]]:
    """Columns and ranges of the features.

    Returns
    -------
    For each feature the lower end of its range, half the width of the range, and whether it has a range. Then the
    columns of the state, (4,), and those of `_NAMED`, -1 for a missing one.
    """
    ends = dict(ranges)
    low, high = np.array([ends.get(name, (-1.0, 1.0)) for name in features]).T
    where, named = ([features.index(x) if x in features else -1 for x in names] for names in (STATE, _NAMED))
    ranged = np.array([name in ends for name in features])
    return low.copy(), (high - low) / 2.0, ranged, np.array(where), tuple(named)


def _heading(named: tuple[int, ...], ego: FloatArray) -> float:
    """Heading of the ego [rad] from the columns of `_NAMED`; NaN if it is not a feature."""
    _, cos, sin, heading = named
    if cos >= 0 and sin >= 0:
        return math.atan2(ego[sin], ego[cos])
    return float(ego[heading]) if heading >= 0 else math.nan
