"""Where the ego's body is on each lane of a network, frame by frame along a path."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import inlined, uncounted
from dynamics.networks.lanes import Lanes, heading_at, local, on_lane, place
from dynamics.networks.layout import (
    ACROSS_X,
    ACROSS_Y,
    ALONG_X,
    ALONG_Y,
    AMPLITUDE,
    CIRCULAR,
    DIRECTION,
    ORIGIN_X,
    ORIGIN_Y,
    PHASE,
    PULSATION,
    RADIUS,
    SHAPE,
    SINE,
)
from dynamics.simulator.layout import LANE_LENGTH
from dynamics.state import BoolArray, FloatArray, IntArray

__all__ = ["FAR_OFF", "Body", "circles_of", "survey"]

FAR_OFF = 1e6
"""The least s of a body that is nowhere near a lane [m]."""
_SAMPLES = 9
"""Points of a lane from which the circle around it is made."""
_WITH = 0.9
"""Cosine of the angle within which the ego drives in the direction of a lane, and counts as being in it."""
_NEAR = 6.0
"""How far from a lane's centre line a body is looked at, beyond its own half diagonal [m]."""


class Body(NamedTuple):
    """Half length and half width of the ego, and the same with its buffer; how near to a lane's centre it is visible in
    it [m]."""

    length: float
    width: float
    along: float
    across: float
    visible: float


@uncounted
def circles_of(lanes: Lanes, circles: FloatArray) -> None:
    """A circle around the centre line of each lane: x, y and radius [m], (n, 3), written."""
    for lane in range(circles.shape[0]):
        length, low_x, low_y, high_x, high_y = lanes.rows[lane, LANE_LENGTH], np.inf, np.inf, -np.inf, -np.inf
        for k in range(_SAMPLES):
            x, y = place(lanes, lane, length * k / (_SAMPLES - 1))
            low_x, low_y, high_x, high_y = min(low_x, x), min(low_y, y), max(high_x, x), max(high_y, y)
        circles[lane, 0], circles[lane, 1] = 0.5 * (low_x + high_x), 0.5 * (low_y + high_y)
        # No point of the lane is further from a sample than half of the way between two of them.
        circles[lane, 2] = 0.5 * math.hypot(high_x - low_x, high_y - low_y) + 0.6 * length / (_SAMPLES - 1)


@inlined
def _widen(box: FloatArray, s: float, r: float, ds: float, dr: float) -> None:
    box[0], box[1] = min(box[0], s - ds), max(box[1], s + ds)
    box[2], box[3] = min(box[2], r - dr), max(box[3], r + dr)


@uncounted
def _box_on_arc(row: FloatArray, x: float, y: float, s: float, points: FloatArray, box: FloatArray) -> None:
    """The box of points (k, 2), as seen from a place at s of an arc; angles from there are less than a right one."""
    ax, ay = x - row[ORIGIN_X], y - row[ORIGIN_Y]
    low, high, near, far = 0.0, 0.0, np.inf, 0.0
    for j in range(points.shape[0]):
        bx, by = ax + points[j, 0], ay + points[j, 1]
        off, cosine, square = ax * by - ay * bx, ax * bx + ay * by, bx * bx + by * by
        # As it grows with the angle, but without one: the tangent, and beyond a right angle its limit.
        slope = off / cosine if cosine > 0.0 else math.copysign(np.inf, off)
        low, high, near, far = min(low, slope), max(high, slope), min(near, square), max(far, square)
    sign, radius = row[DIRECTION], row[RADIUS]
    one, other = sign * math.atan(low) * radius, sign * math.atan(high) * radius
    box[0], box[1] = s + min(one, other), s + max(one, other)
    one, other = sign * (radius - math.sqrt(near)), sign * (radius - math.sqrt(far))
    box[2], box[3] = min(one, other), max(one, other)


@uncounted
def _box_on_line(
    row: FloatArray, s: float, r: float, cos: float, sin: float, body: Body, way: float, box: FloatArray
) -> None:
    """The box of a body about a place of a straight lane, and of what it is without its buffer `way` further on."""
    along, across = cos * row[ALONG_X] + sin * row[ALONG_Y], cos * row[ACROSS_X] + sin * row[ACROSS_Y]
    aside, beside = sin * row[ALONG_X] - cos * row[ALONG_Y], sin * row[ACROSS_X] - cos * row[ACROSS_Y]
    ds, dr = abs(along) * body.along + abs(aside) * body.across, abs(across) * body.along + abs(beside) * body.across
    _widen(box, s, r, ds, dr)
    ds, dr = abs(along) * body.length + abs(aside) * body.width, abs(across) * body.length + abs(beside) * body.width
    _widen(box, s + along * way, r + across * way, ds, dr)


@uncounted
def _box_on_sine(row: FloatArray, s: float, r: float, points: FloatArray, box: FloatArray) -> None:
    """The box of points (k, 2) about a place of a sine."""
    swing, rate, phase = row[AMPLITUDE], row[PULSATION], row[PHASE]
    straight = r + swing * math.sin(rate * s + phase)
    for j in range(points.shape[0]):
        at = s + points[j, 0] * row[ALONG_X] + points[j, 1] * row[ALONG_Y]
        off = straight + points[j, 0] * row[ACROSS_X] + points[j, 1] * row[ACROSS_Y]
        _widen(box, at, off - swing * math.sin(rate * at + phase), 0.0, 0.0)


@uncounted
def survey(
    lanes: Lanes,
    circles: FloatArray,
    which: IntArray,
    path: FloatArray,
    count: int,
    body: Body,
    period: float,
    points: FloatArray,
    boxes: FloatArray,
    seen: BoolArray,
    met: IntArray,
) -> None:
    """Where the ego with its buffer is on some lanes, at each of the first `count` places of a path (K, 4).

    Parameters
    ----------
    which : the lanes. period : of a frame [s]. points : (12, 2), written.
    boxes : (n, K, 4), written: the least and the greatest s and r of it [m]; the first is `FAR_OFF` where it is not
        near. seen : (n, K), written: whether it drives in the lane, in its direction, where others in it see it.
    met : the first and the last frame in which it is near, (n, 2), written; the last before the first for never.
    """
    reach = math.hypot(body.along, body.across) + _NEAR
    for lane in which:
        met[lane, 0], met[lane, 1] = count, -1
    for k in range(count):
        x, y, heading = path[k, 0], path[k, 1], path[k, 2]
        cos, sin, way = math.cos(heading), math.sin(heading), path[k, 3] * period
        for j in range(12):
            if j < 8:
                # Eight of nine places on a grid: not the middle.
                cell = j if j < 4 else j + 1
                a, b = (cell // 3 - 1) * body.along, (cell % 3 - 1) * body.across
            else:
                # highway-env counts a collision that constant velocities would bring within the coming frame.
                a, b = (2 * (j // 2 % 2) - 1) * body.length + way, (2 * (j % 2) - 1) * body.width
            points[j, 0], points[j, 1] = cos * a - sin * b, sin * a + cos * b
        for lane in which:
            box, row = boxes[lane, k], lanes.rows[lane]
            box[0], seen[lane, k] = FAR_OFF, False
            dx, dy, far = x - circles[lane, 0], y - circles[lane, 1], circles[lane, 2] + reach
            if dx * dx + dy * dy > far * far:
                continue
            s, r = local(lanes, lane, x, y)
            if abs(r) > reach or s < -reach or s > row[LANE_LENGTH] + reach:
                continue
            shape = lanes.ids[lane, SHAPE]
            if shape == CIRCULAR:
                _box_on_arc(row, x, y, s, points, box)
                # Between two points that are looked at, a side that is straight comes nearer to the middle of an arc.
                bulge = body.along * body.along / (8 * row[RADIUS])
                box[2] -= bulge
                box[3] += bulge
            else:
                box[0], box[1], box[2], box[3] = s, s, r, r
                if shape == SINE:
                    _box_on_sine(row, s, r, points, box)
                else:
                    _box_on_line(row, s, r, cos, sin, body, way, box)
            met[lane, 0], met[lane, 1] = min(met[lane, 0], k), k
            if abs(r) <= body.visible and on_lane(lanes.rows, lane, s, 0.0, 0.0):
                aim = heading_at(lanes, lane, min(max(s, 0.0), row[LANE_LENGTH]))
                seen[lane, k] = math.cos(heading - aim) >= _WITH
