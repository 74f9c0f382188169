"""What one observation shows, in metres and in the world's directions."""

from __future__ import annotations

import math
from dataclasses import dataclass
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
    columns = {name: _in_units(spec, name, seen[:, k]) for k, name in enumerate(spec.features)}
    at_edge = {name: _at_edge(spec, name, seen[:, k]) for k, name in enumerate(spec.features)}
    lost = [name for name in STATE[1:] if at_edge[name][0]]
    if lost:
        raise SceneError(f"the ego's {', '.join(lost)} is at the edge of its range: nobody knows what it is")
    state = np.stack([columns[name] for name in STATE], axis=1)
    ego, others = state[0], state[1:].copy()
    if spec.absolute:
        others[:, 0] -= ego[0]
    else:
        others[:, 1:] += ego[1:]
    if at_edge["x"][0]:
        ego[0] = np.nan
    known = ~np.any([at_edge[name][1:] for name in STATE], axis=0)
    return Sighting(
        ego,
        others[known],
        _heading(columns),
        np.flatnonzero(there)[1:][known],
        bool(there.all()),
        not bool(known.all()),
    )


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


def _in_units(spec: ObservationSpec, name: str, column: FloatArray) -> FloatArray:
    """A feature in its own unit."""
    if name not in spec.ranges:  # type: ignore[operator]
        return column
    low, high = spec.ranges[name]  # type: ignore[index]
    return low + (column + 1.0) * (high - low) / 2.0


def _at_edge(spec: ObservationSpec, name: str, column: FloatArray) -> BoolArray:
    """Where a feature may be anything beyond its range."""
    clipped = spec.clip and name in spec.ranges  # type: ignore[operator]
    return np.abs(column) >= _EDGE if clipped else np.zeros(len(column), dtype=bool)


def _there(spec: ObservationSpec, rows: FloatArray) -> BoolArray:
    """Which rows show a vehicle, (rows,)."""
    if "presence" in spec.features:
        there: BoolArray = rows[:, spec.features.index("presence")] > 0.5
        return there
    filled: BoolArray = np.any(np.abs(rows) > _FULL, axis=1)
    filled[0] = True
    return filled


def _heading(columns: dict[str, FloatArray]) -> float:
    if "cos_h" in columns and "sin_h" in columns:
        return float(np.arctan2(columns["sin_h"][0], columns["cos_h"][0]))
    return float(columns["heading"][0]) if "heading" in columns else float("nan")
