"""Decoding of an occupancy grid, relative to the ego, into metres and the road's directions.

Notation
--------
The position of a vehicle is bounded by the box of its cell, and by the layers x and y where these can be read. A byte q
of an image stands for the numbers from 2 q / 255 - 1 to 2 (q + 1) / 255 - 1; its extreme values also stand for numbers
beyond the range. If the grid is aligned with the ego, its cells are turned by the ego's heading.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynamics.state import BoolArray, FloatArray
from shield.errors import SceneError
from shield.perception.grid_spec import GridSpec
from shield.perception.sighting import numbers_of
from shield.perception.spec import STATE

__all__ = ["DecodedGrid", "covered_distance", "decode_grid", "lane_in_grid"]

_EDGE = 1.0 - 1e-6
_BYTE = 255.0
_SLACK = 1e-6
"""A lane centre this near to the side of a cell may be shown in either cell [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class DecodedGrid:
    """One decoded grid.

    Attributes
    ----------
    low, high : bounds of x, y [m], vx and vy [m/s] of each observed vehicle, relative to the ego, (m, 4).
    cells : boxes of the occupied cells, the ego's own first: least and greatest x, then y, (m + 1, 4) [m].
    cut : whether the velocity of a vehicle is at the edge of its range, and so unknown.
    """

    low: FloatArray
    high: FloatArray
    cells: FloatArray
    cut: bool


def decode_grid(spec: GridSpec, observation: object, heading: float = 0.0) -> DecodedGrid:
    """Decode a grid.

    Parameters
    ----------
    observation : of shape `spec.shape`, or flattened. heading : of the ego, relative to the road [rad].

    Raises
    ------
    SceneError
        If it is not an array of real numbers, has another shape, is not finite, or does not show the ego.
    """
    grid = numbers_of(observation, spec.shape)
    there = grid[spec.features.index("presence")] > 0.5 * (_BYTE if spec.image else 1.0)
    own = tuple(math.floor(-low / step) for (low, _), step in zip(spec.size, spec.step, strict=True))
    if not there[own]:
        raise SceneError("the observation does not show the ego: its own cell is empty")
    there[own] = False
    index = np.concatenate([[own], np.argwhere(there)])
    cells = _boxes(spec, index, heading if spec.aligned else 0.0)
    others = index[1:]
    low, high = np.zeros((len(others), 4)), np.zeros((len(others), 4))
    low[:, :2], high[:, :2] = cells[1:, [0, 2]], cells[1:, [1, 3]]
    cut = np.zeros(len(others), dtype=bool)
    for k, name in enumerate(STATE):
        if not spec.legible(name):
            continue
        shown = grid[spec.features.index(name)][others[:, 0], others[:, 1]]
        lower, upper, edge = _between(spec, name, shown)
        if name in STATE[:2]:
            # A position beyond the range is still bounded by the cell.
            lower, upper = np.where(edge, low[:, k], lower), np.where(edge, high[:, k], upper)
        else:
            cut |= edge
        low[:, k], high[:, k] = lower, upper
    return DecodedGrid(low[~cut], high[~cut], np.concatenate([cells[:1], cells[1:][~cut]]), bool(cut.any()))


def lane_in_grid(spec: GridSpec, observation: object, centers: FloatArray) -> int:
    """Lane of the ego, which is in the middle of it, from the layer `on_road`.

    Parameters
    ----------
    centers : lane centres across the road, (lanes,) [m].

    Raises
    ------
    SceneError
        If the layer is missing, or fits several lanes.
    """
    if "on_road" not in spec.features:
        raise SceneError(
            "the grid does not show which lane the ego begins in: add 'on_road' to config['observation']['features'], "
            "or set config['initial_lane_id']"
        )
    grid = numbers_of(observation, spec.shape)
    layer = grid[spec.features.index("on_road")] > 0.5 * (_BYTE if spec.image else 1.0)
    seen, (low, _), step = layer.any(axis=0), spec.size[1], spec.step[1]
    fits = []
    for lane, center in enumerate(centers):
        for slack in (-_SLACK, 0.0, _SLACK):
            cells = np.floor((centers - center + slack - low) / step).astype(int)
            expected = np.zeros_like(seen)
            expected[cells[(cells >= 0) & (cells < len(seen))]] = True
            if np.array_equal(expected, seen):
                fits.append(lane)
                break
    if len(fits) != 1:
        raise SceneError(
            f"the grid's road fits the lanes {fits or 'of no ego in the middle of a lane'}: make its cells narrower, "
            "or set config['initial_lane_id']"
        )
    return fits[0]


def covered_distance(spec: GridSpec, left: float, right: float, heading: float) -> tuple[float, float]:
    """Distance ahead and behind the ego over which the grid covers the whole width of the road [m]; 0 where it does
    not.

    Parameters
    ----------
    left, right : outermost lateral positions that a vehicle may have, relative to the ego [m].
    heading : of the ego, relative to the road [rad].
    """
    turn = heading if spec.aligned else 0.0
    cos, sin = math.cos(turn), math.sin(turn)
    _, along, across = spec.shape
    ends = [
        (low, low + many * step) for (low, _), many, step in zip(spec.size, (along, across), spec.step, strict=True)
    ]
    far = back = spec.distance
    for d in (left, right):
        for slope, start, (low, high) in ((cos, sin * d, ends[0]), (-sin, cos * d, ends[1])):
            if not low <= start <= high:
                return 0.0, 0.0
            if slope:
                limits = sorted(((low - start) / slope, (high - start) / slope))
                far, back = min(far, limits[1]), min(back, -limits[0])
    return far, back


def _boxes(spec: GridSpec, index: object, turn: float) -> FloatArray:
    """Bounding boxes of cells, in the road's directions: least and greatest x, then y, (m, 4) [m]."""
    corners = np.array([(0, 0), (0, 1), (1, 0), (1, 1)])
    start = np.array([spec.size[0][0], spec.size[1][0]])
    places = (np.asarray(index)[:, None] + corners) * np.array(spec.step) + start
    cos, sin = math.cos(turn), math.sin(turn)
    turned = places @ np.array([[cos, sin], [-sin, cos]])
    low, high = turned.min(axis=1), turned.max(axis=1)
    return np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=1)


def _between(spec: GridSpec, name: str, shown: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Lower and upper bound of a feature in its own unit, and whether it is at the edge of its range, (m,) each."""
    lower, upper, edge = shown, shown, np.zeros(len(shown), dtype=bool)
    if spec.image:
        lower, upper = 2 * shown / _BYTE - 1, np.minimum(2 * (shown + 1) / _BYTE - 1, 1.0)
        edge = (shown < 0.5) | (shown > _BYTE - 0.5)
    elif spec.clip:
        edge = np.abs(shown) >= _EDGE
    if name in spec.ranges:  # type: ignore[operator]
        low, high = spec.ranges[name]  # type: ignore[index]
        lower, upper = (low + (each + 1) * (high - low) / 2 for each in (lower, upper))
    return lower, upper, edge
