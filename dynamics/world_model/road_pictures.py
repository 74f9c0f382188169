"""Roads in the form from which frames are drawn: the cross-section of a straight highway, or a map of cells."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from highway_env.road.lane import LineType, StraightLane
from numpy.typing import NDArray

from dynamics.compiled import kernel_no_refcount
from dynamics.highway_simulator.arithmetic import sums_of_numpy
from dynamics.highway_simulator.layout import LANE_LENGTH, LANE_WIDTH
from dynamics.highway_simulator.loops import addresses
from dynamics.road_networks.geometry.lanes import NetworkLanes, local
from dynamics.road_networks.geometry.layout import LEAST_X, LEAST_Y, MOST_X, MOST_Y
from dynamics.road_networks.geometry.network import network_of
from dynamics.state import FloatArray

__all__ = ["RoadPicture", "road_picture"]

CELL = 0.5
"""Size of a cell of the map [m]."""
CONTINUOUS, STRIPED = 255, 128
"""Brightness of markings."""
_TOLERANCE = 1e-6
"""Difference between positions of equal lanes [m]."""


class RoadPicture(NamedTuple):
    """A road to draw.

    Attributes
    ----------
    lanes : number of lanes of a straight highway along x; 0 if the map is drawn.
    low, width : left edge of its first lane and width of a lane [m].
    origin_x, origin_y : corner of the map [m].
    wide, high : columns and rows of the map; its edge is off the road.
    cells : cells of `CELL` metres, row by row: how drivable each is, plus 256 times how marked.
    """

    lanes: int
    low: float
    width: float
    origin_x: float
    origin_y: float
    wide: int
    high: int
    cells: NDArray[np.uint16]


_NO_CELLS = np.zeros(0, np.uint16)


def road_picture(network: Any) -> RoadPicture:
    """Picture of highway-env's `RoadNetwork`.

    A straight highway is drawn without ends, with dashed lines between its lanes.

    Raises
    ------
    SceneError
        If a lane is neither straight nor a sine nor an arc.
    """
    lanes = network.lanes_list()
    return _highway(lanes) or _mapped(network, lanes)


def _highway(lanes: list[Any]) -> RoadPicture | None:
    """Parallel lanes of one width along x, side by side; None for other roads."""
    if any(type(lane) is not StraightLane or lane.heading != 0 for lane in lanes):
        return None
    centers, widths = np.array([lane.start[1] for lane in lanes]), np.array([lane.width for lane in lanes])
    starts, ends = np.array([lane.start[0] for lane in lanes]), np.array([lane.end[0] for lane in lanes])
    width = float(widths[0])
    apart = np.abs(np.diff(centers) - width).max(initial=0.0)
    uneven = max(np.ptp(widths), np.ptp(starts), np.ptp(ends), apart)
    last = len(lanes) - 1
    marked = all(
        (lane.line_types[0] == LineType.CONTINUOUS_LINE if k == 0 else lane.line_types[0] == LineType.STRIPED)
        and lane.line_types[1] == (LineType.CONTINUOUS_LINE if k == last else LineType.NONE)
        for k, lane in enumerate(lanes)
    )
    if uneven > _TOLERANCE or not marked:
        return None
    return RoadPicture(len(lanes), float(centers[0]) - 0.5 * width, width, 0.0, 0.0, 0, 0, _NO_CELLS)


def _mapped(network: Any, lanes: list[Any]) -> RoadPicture:
    """The map of any lanes."""
    read = network_of(network)
    rows = read.lanes
    margin = 2 * CELL + 0.5 * float(rows[:, LANE_WIDTH].max())
    low = np.floor((rows[:, [LEAST_X, LEAST_Y]].min(axis=0) - margin) / CELL) * CELL
    high = rows[:, [MOST_X, MOST_Y]].max(axis=0) + margin
    nx, ny = np.ceil((high - low) / CELL).astype(int)
    marks = np.array([[_brightness(line) for line in lane.line_types] for lane in lanes], float)
    cells = np.zeros((2, ny, nx), np.uint8)
    shapes = NetworkLanes(sums_of_numpy()[0], addresses(), rows, read.ids, read.near)
    _fill(shapes, marks, (float(low[0]), float(low[1])), margin, cells)
    packed = cells[0].astype(np.uint16) | cells[1].astype(np.uint16) << 8
    return RoadPicture(0, 0.0, 0.0, float(low[0]), float(low[1]), int(nx), int(ny), packed.ravel())


def _brightness(line: int) -> int:
    if line == LineType.NONE:
        return 0
    return STRIPED if line == LineType.STRIPED else CONTINUOUS


@kernel_no_refcount
def _fill(
    lanes: NetworkLanes, marks: FloatArray, origin: tuple[float, float], margin: float, cells: NDArray[np.uint8]
) -> None:
    """Draw the lanes into the map: in each cell, the most of all lanes.

    Parameters
    ----------
    marks : brightness of the lines on the left and on the right of each lane, (n, 2).
    margin : distance from the boxes around centre lines within which cells are drawn [m].
    """
    for n in range(len(lanes.rows)):
        row = lanes.rows[n]
        half = 0.5 * row[LANE_WIDTH]
        first_x, last_x = int((row[LEAST_X] - margin - origin[0]) / CELL), (row[MOST_X] + margin - origin[0]) / CELL
        first_y, last_y = int((row[LEAST_Y] - margin - origin[1]) / CELL), (row[MOST_Y] + margin - origin[1]) / CELL
        for j in range(max(first_y, 0), min(int(last_y) + 1, cells.shape[1])):
            for i in range(max(first_x, 0), min(int(last_x) + 1, cells.shape[2])):
                s, r = local(lanes, n, origin[0] + (i + 0.5) * CELL, origin[1] + (j + 0.5) * CELL)
                along = min(s, row[LANE_LENGTH] - s) / CELL + 0.5
                if along <= 0.0:
                    continue
                along = min(along, 1.0)
                inside = min(max((half - abs(r)) / CELL + 0.5, 0.0), 1.0)
                left = marks[n, 0] * max(1.0 - abs(r + half) / CELL, 0.0)
                right = marks[n, 1] * max(1.0 - abs(r - half) / CELL, 0.0)
                cells[0, j, i] = max(cells[0, j, i], np.uint8(255.0 * along * inside + 0.5))
                cells[1, j, i] = max(cells[1, j, i], np.uint8(along * max(left, right) + 0.5))
