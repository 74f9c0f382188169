"""What one observation shows, in metres and in the world's directions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from dynamics.state import BoolArray, FloatArray, IntArray
from shield.errors import SceneError
from shield.perception.spec import STATE, ObservationSpec

__all__ = ["Sighting", "decode", "numbers_of"]

_EDGE = 1.0 - 1e-6
"""A normalised and clipped number from here on may stand for anything beyond its range."""
_FULL = 1e-3
"""Rows whose numbers are all smaller than this, with no presence to go by, are empty."""


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """One observation, decoded.

    Attributes
    ----------
    ego : x, y [m], vx, vy [m/s] of the ego, (4,); x is NaN where it has left the range.
    others : the same of those seen, (m, 4), relative in x to the ego, absolute in y, vx and vy.
    heading : of the ego [rad], NaN where it is not a feature.
    places : row of each of the others, (m,).
    full : whether there is no empty row, so that more may be there than are shown.
    cut : whether some row is at the edge of a range: somebody is there, and nobody knows where.
    """

    ego: FloatArray
    others: FloatArray
    heading: float
    places: IntArray
    full: bool
    cut: bool


def decode(spec: ObservationSpec, observation: object) -> Sighting:
    """Read an observation.

    Parameters
    ----------
    observation : of shape `spec.shape`, or the same flattened.

    Raises
    ------
    SceneError
        If it is no array of real numbers, has another shape, is not finite, or does not show the ego.
    """
    rows = numbers_of(observation, spec.shape)
    there = _there(spec, rows)
    if not there[0]:
        raise SceneError("the observation does not show the ego: its first row is empty")
    seen = rows[there]
    low, half, ranged = _scales(spec.features, tuple(spec.ranges.items()))  # type: ignore[union-attr]
    # What is in its own units already keeps every digit.
    columns = low + (seen + 1.0) * half if ranged.all() else np.where(ranged, low + (seen + 1.0) * half, seen)
    x, *others_at = where = [spec.features.index(name) for name in STATE]
    at_edge = (np.abs(seen) >= _EDGE) & ranged if spec.clip else None
    if at_edge is not None and not at_edge.any():
        at_edge = None
    if at_edge is not None and at_edge[0, others_at].any():
        lost = [name for name, k in zip(STATE[1:], others_at, strict=True) if at_edge[0, k]]
        raise SceneError(f"the ego's {', '.join(lost)} is at the edge of its range: nobody knows what it is")
    state = columns[:, where]
    ego, others, places = state[0], state[1:], np.flatnonzero(there)[1:]
    if spec.absolute:
        others[:, 0] -= ego[0]
    else:
        others[:, 1:] += ego[1:]
    full, cut = len(seen) == len(rows), False
    if at_edge is not None:
        if at_edge[0, x]:
            ego[0] = np.nan
        known = ~at_edge[1:, where].any(axis=1)
        cut = not known.all()
        others, places = others[known], places[known]
    return Sighting(ego, others, _heading(spec, columns[0]), places, full, cut)


def numbers_of(observation: object, shape: tuple[int, ...]) -> FloatArray:
    """An observation as 64-bit numbers of the shape that is expected.

    Raises
    ------
    SceneError
        If it is no array of real numbers, has neither this shape nor the same flattened, or is not finite.
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
    return f"of {given.dtype}" if given.ndim else type(observation).__name__


@lru_cache(maxsize=16)
def _scales(
    features: tuple[str, ...], ranges: tuple[tuple[str, tuple[float, float]], ...]
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """The lower end of the range of each feature, half of how far it is to the upper one, and whether it has one."""
    ends = dict(ranges)
    low, high = np.array([ends.get(name, (-1.0, 1.0)) for name in features]).T
    return low, (high - low) / 2.0, np.array([name in ends for name in features])


def _there(spec: ObservationSpec, rows: FloatArray) -> BoolArray:
    """Which rows show a vehicle, (rows,)."""
    if "presence" in spec.features:
        there: BoolArray = rows[:, spec.features.index("presence")] > 0.5
        return there
    filled: BoolArray = np.any(np.abs(rows) > _FULL, axis=1)
    filled[0] = True
    return filled


def _heading(spec: ObservationSpec, ego: FloatArray) -> float:
    of = dict(zip(spec.features, ego.tolist(), strict=True))
    if "cos_h" in of and "sin_h" in of:
        return math.atan2(of["sin_h"], of["cos_h"])
    return of.get("heading", math.nan)
