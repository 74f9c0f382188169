"""Observation of the ego as a map: highway-env's OccupancyGrid, in the axes of the world."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.arithmetic import clip
from dynamics.highway_simulator.arrays import Bodies, ObservationConfig
from dynamics.highway_simulator.layout import LANE_LENGTH, LANE_Y, X, Y
from dynamics.highway_simulator.observe import feature_of
from dynamics.state import FloatArray

__all__ = ["LAYERS", "ON_ROAD", "occupancy_grid"]

ON_ROAD = 13
"""The layer that is 1 where there is a lane; the others are numbered as `observe.FEATURES`."""
LAYERS = ("on_road",)
"""Layers of a grid beyond `observe.FEATURES`."""
_REACH = 100.0
"""Distance before and behind the ego over which lanes are drawn [m]."""
_RELATIVE = 5


@kernel_inline
def _there_and_back(value: float, low: float, high: float) -> float:
    """A coordinate mapped to [-1, 1] and back, as highway-env does, for the same rounding."""
    if math.isnan(low):
        return value
    mapped = -1 + (value - low) * 2 / (high - low)
    return low + (mapped - -1) * (high - low) / 2


@kernel_no_refcount
def _draw_road(f: FloatArray, lanes: FloatArray, grid: FloatArray, layer: FloatArray) -> None:
    """Fill in the layer of the lanes."""
    x, y, spacing = f[X, 0], f[Y, 0], min(grid[0, 1], grid[1, 1])
    across = int(grid[1, 2])
    start = x - _REACH
    # As `np.arange` computes its values.
    count, step = math.ceil((x + _REACH - start) / spacing), start + spacing - start
    for lane in range(len(lanes)):
        j = math.floor((lanes[lane, LANE_Y] - y - grid[1, 0]) / grid[1, 1])
        if not 0 <= j < across:
            continue
        for k in range(count):
            at = start + k * step if k != 1 else start + spacing
            at = clip(at, 0.0, lanes[lane, LANE_LENGTH])
            i = math.floor((at - x - grid[0, 0]) / grid[0, 1])
            if 0 <= i < int(grid[0, 2]):
                layer[int(i) * across + int(j)] = 1.0


@kernel_no_refcount
def occupancy_grid(
    bodies: Bodies, vehicles: int, view: ObservationConfig, seen: FloatArray, out: NDArray[np.float32]
) -> None:
    """Write a layer for each feature, (layers, cells along times cells across), to `out`.

    Parameters
    ----------
    view : `features`, indices in `observe.FEATURES`, or `ON_ROAD`; `ranges` (layers, 2), the values mapped to -1 and 1,
        NaN for layers that are not normalised; `places` (2, 2), the same for x and y, by which cells are found; `grid`
        (2, 3), least coordinate [m], size [m] and number of the cells along and across.
    seen : buffer like `out`, written.
    """
    f, g, lanes, clipped = bodies.f, bodies.g, bodies.lanes, view.switches[2]
    features, ranges, places, grid = view.features, view.ranges, view.places, view.grid
    across = int(grid[1, 2])
    seen[:] = math.nan
    for layer in range(len(features)):
        feature = features[layer]
        if feature == ON_ROAD:
            _draw_road(f, lanes, grid, seen[layer])
            continue
        for i in range(vehicles - 1, -1, -1):
            x = _there_and_back(f[X, i] - f[X, 0], places[0, 0], places[0, 1])
            y = _there_and_back(f[Y, i] - f[Y, 0], places[1, 0], places[1, 1])
            row, column = math.floor((x - grid[0, 0]) / grid[0, 1]), math.floor((y - grid[1, 0]) / grid[1, 1])
            if not (0 <= row < grid[0, 2] and 0 <= column < grid[1, 2]):
                continue
            value = feature_of(f, g, lanes, i, feature)
            if 1 <= feature < _RELATIVE:
                value -= feature_of(f, g, lanes, 0, feature)
            if not math.isnan(ranges[layer, 0]):
                value = -1 + (value - ranges[layer, 0]) * 2 / (ranges[layer, 1] - ranges[layer, 0])
            seen[layer, int(row) * across + int(column)] = value
    for layer in range(len(features)):
        for cell in range(seen.shape[1]):
            value = seen[layer, cell]
            if math.isnan(value):
                out[layer, cell] = np.float32(0.0)
            else:
                out[layer, cell] = np.float32(clip(value, -1.0, 1.0) if clipped else value)
