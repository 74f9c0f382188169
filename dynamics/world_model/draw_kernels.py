"""Compiled drawing of bird's-eye frames: the road below, and the footprints of the ego and of others."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.layout import COS, KIND, LENGTH, OBSTACLE, SIN, SPEED, WIDTH, X, Y
from dynamics.road_networks.simulation.frame_kernels import ego_of
from dynamics.state import FloatArray, IntArray
from dynamics.world_model.road_pictures import CELL, CONTINUOUS, STRIPED, RoadPicture
from dynamics.world_model.view import DRIVABLE, EGO, MARKINGS, OTHERS, RELATIVE_SPEED, ViewNumbers

__all__ = ["BODY_COLUMNS", "DrawWork", "SceneBodies", "draw", "draw_all"]

BODY_COLUMNS = 7
"""Columns of a body: x, y [m], cosine and sine of the heading, speed [m/s], length, width [m]."""
_X, _Y, _COS, _SIN, _SPEED, _LENGTH, _WIDTH = range(BODY_COLUMNS)
_EQUAL_SPEED, _SPEED_RANGE = 128.0, 127.0
_STANDING = 0.25
"""Brightness of an ego that stands, as a share."""

_MARKED, _DASHED = np.float32(CONTINUOUS), np.float32(STRIPED)
_ONE, _ZERO, _HALF, _FULL = np.float32(1), np.float32(0), np.float32(0.5), np.float32(255)


class SceneBodies(NamedTuple):
    """Bodies of e compiled environments: `f`, `g`, `p` (see `dynamics.highway_simulator.layout`), and the number of
    bodies of each, (e,)."""

    f: FloatArray
    g: IntArray
    p: FloatArray
    counts: IntArray


class DrawWork(NamedTuple):
    """Buffers of the kernels.

    Attributes
    ----------
    columns : 0, 1, ... of each column, read. places : index of the cell under each pixel of a row, overwritten.
    bodies : (m, BODY_COLUMNS), overwritten by `draw_all`.
    """

    columns: NDArray[np.float32]
    places: NDArray[np.uint32]
    bodies: FloatArray

    @classmethod
    def of(cls, size: int, bodies: int = 0) -> DrawWork:
        """Buffers for frames of `size` columns, and for scenes of up to `bodies` bodies."""
        return cls(np.arange(size, dtype=np.float32), np.empty(size, np.uint32), np.empty((bodies, BODY_COLUMNS)))


@kernel_inline
def _clip(value: np.float32) -> np.float32:
    """The value between 0 and 1."""
    return min(max(value, _ZERO), _ONE)


@kernel_no_refcount
def _draw_highway(
    ego: FloatArray, road: RoadPicture, view: ViewNumbers, work: DrawWork, out: NDArray[np.uint8]
) -> None:
    """The lanes of a straight highway, and their lines."""
    # The next pixel of a row is `step` further across the road, and a pixel covers `1 / share` metres of it.
    along, down = ego[_SIN] * view.length, ego[_COS] * view.width
    share, step = np.float32(1.0 / (abs(along) + abs(down))), np.float32(along)
    width, lanes, per_lane = np.float32(road.width), np.float32(road.lanes), np.float32(1.0 / road.width)
    most, columns = lanes * width, work.columns
    first = ego[_Y] - road.low - ego[_SIN] * (view.behind - 0.5 * view.length)
    # 32-bit numbers throughout: the loop over the columns becomes vector instructions.
    for j in range(out.shape[1]):
        start = np.float32(first + ego[_COS] * ((j + 0.5) * view.width - view.side))
        drivable, marked = out[DRIVABLE, j], out[MARKINGS, j]
        for i in range(len(columns)):
            r = start + columns[i] * step
            drivable[i] = np.uint8(np.int32(_FULL * _clip(min(r, most - r) * share + _HALF) + _HALF))
            line = np.float32(np.int32(min(max(r * per_lane + _HALF, _ZERO), lanes + _HALF)))
            bright = _MARKED if line < _HALF or line > lanes - _HALF else _DASHED
            marked[i] = np.uint8(np.int32(bright * _clip(_ONE - abs(r - line * width) * share) + _HALF))


@kernel_no_refcount
def _draw_map(ego: FloatArray, road: RoadPicture, view: ViewNumbers, work: DrawWork, out: NDArray[np.uint8]) -> None:
    """The cells of the map under the centre of each pixel."""
    cos, sin, back = ego[_COS] / CELL, ego[_SIN] / CELL, view.behind - 0.5 * view.length
    step_x, step_y = np.float32(cos * view.length), np.float32(sin * view.length)
    wide, last_x, last_y = np.int32(road.wide), np.float32(road.wide - 1), np.float32(road.high - 1)
    columns, places, cells = work.columns, work.places, road.cells
    for j in range(out.shape[1]):
        across = (j + 0.5) * view.width - view.side
        x = np.float32((ego[_X] - road.origin_x) / CELL - cos * back - sin * across)
        y = np.float32((ego[_Y] - road.origin_y) / CELL - sin * back + cos * across)
        # Outside of the map is what lies at its edge: no lane.
        for i in range(len(columns)):
            column = np.int32(min(max(x + columns[i] * step_x, _ZERO), last_x))
            row = np.int32(min(max(y + columns[i] * step_y, _ZERO), last_y))
            places[i] = np.uint32(row * wide + column)
        drivable, marked = out[DRIVABLE, j], out[MARKINGS, j]
        for i in range(len(columns)):
            cell = cells[places[i]]
            drivable[i], marked[i] = np.uint8(cell & 255), np.uint8(cell >> 8)


@kernel_inline
def _covered(distance: float, half_pixel: float, half_body: float) -> float:
    """Share of a pixel that the body covers, along one axis of the body."""
    low, high = max(distance - half_pixel, -half_body), min(distance + half_pixel, half_body)
    return max(high - low, 0.0) / (2.0 * half_pixel)


@kernel_no_refcount
def _draw_body(ego: FloatArray, body: FloatArray, view: ViewNumbers, own: bool, out: NDArray[np.uint8]) -> None:
    """One footprint, of the ego itself (`own`) or of another body."""
    rows, columns = out.shape[1:]
    dx, dy = body[_X] - ego[_X], body[_Y] - ego[_Y]
    x, y = ego[_COS] * dx + ego[_SIN] * dy, ego[_COS] * dy - ego[_SIN] * dx
    cos = ego[_COS] * body[_COS] + ego[_SIN] * body[_SIN]
    sin = ego[_COS] * body[_SIN] - ego[_SIN] * body[_COS]
    half_length, half_width = 0.5 * body[_LENGTH], 0.5 * body[_WIDTH]
    half_x = abs(cos) * half_length + abs(sin) * half_width
    half_y = abs(sin) * half_length + abs(cos) * half_width
    left, right = (x - half_x + view.behind) / view.length, (x + half_x + view.behind) / view.length
    top, bottom = (y - half_y + view.side) / view.width, (y + half_y + view.side) / view.width
    # Written so that a body at an unknown place (NaN) is not drawn.
    if not (right > 0.0 and bottom > 0.0 and left < columns and top < rows):
        return
    half_u = 0.5 * (abs(cos) * view.length + abs(sin) * view.width)
    half_v = 0.5 * (abs(sin) * view.length + abs(cos) * view.width)
    if own:
        speed = min(max(body[_SPEED] / view.top_speed, 0.0), 1.0)
        bright, channel, shade = 255.0 * (_STANDING + (1.0 - _STANDING) * speed), EGO, np.uint8(0)
    else:
        faster = min(max((body[_SPEED] * cos - ego[_SPEED]) / view.relative_speed, -1.0), 1.0)
        bright, channel = 255.0, OTHERS
        shade = np.uint8(_EQUAL_SPEED + _SPEED_RANGE * faster + 0.5)
    for j in range(max(int(top), 0), min(int(bottom) + 1, rows)):
        for i in range(max(int(left), 0), min(int(right) + 1, columns)):
            px = (i + 0.5) * view.length - view.behind - x
            py = (j + 0.5) * view.width - view.side - y
            u, v = cos * px + sin * py, cos * py - sin * px
            covered = _covered(u, half_u, half_length) * _covered(v, half_v, half_width)
            value = np.uint8(bright * covered + 0.5)
            if value > out[channel, j, i]:
                out[channel, j, i] = value
                if not own:
                    out[RELATIVE_SPEED, j, i] = shade


@kernel_no_refcount
def draw(
    bodies: FloatArray, own: int, road: RoadPicture, view: ViewNumbers, work: DrawWork, out: NDArray[np.uint8]
) -> None:
    """Draw a frame.

    Parameters
    ----------
    bodies : (m, BODY_COLUMNS). own : the row of the ego.
    out : the frame, (5, rows, columns), written.
    """
    ego = bodies[own]
    out[EGO:] = 0
    if road.lanes > 0:
        _draw_highway(ego, road, view, work, out)
    else:
        _draw_map(ego, road, view, work, out)
    for i in range(len(bodies)):
        _draw_body(ego, bodies[i], view, i == own, out)


@kernel_no_refcount
def draw_all(
    scenes: SceneBodies,
    which: IntArray,
    road: RoadPicture,
    view: ViewNumbers,
    work: DrawWork,
    out: NDArray[np.uint8],
) -> None:
    """Draw the frames of some compiled environments.

    Parameters
    ----------
    which : the environments.
    out : the frames, (e, 5, rows, columns), written at `which`.
    """
    for e in which:
        f, g, p, count = scenes.f[e], scenes.g[e], scenes.p[e], scenes.counts[e]
        for i in range(count):
            row = work.bodies[i]
            row[_X], row[_Y], row[_COS], row[_SIN] = f[X, i], f[Y, i], f[COS, i], f[SIN, i]
            row[_SPEED] = 0.0 if g[KIND, i] == OBSTACLE else f[SPEED, i]
            row[_LENGTH], row[_WIDTH] = p[LENGTH, i], p[WIDTH, i]
        draw(work.bodies[:count], ego_of(g), road, view, work, out[e])
