"""Where the ego's body is on each lane of a network, frame by frame along a path."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import uncounted
from dynamics.networks.lanes import Lanes, heading_at, local, on_lane, place
from dynamics.networks.layout import CIRCULAR, RADIUS, SHAPE
from dynamics.simulator.arithmetic import wrap_to_pi
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


@uncounted
def survey(
    lanes: Lanes,
    circles: FloatArray,
    path: FloatArray,
    count: int,
    body: Body,
    period: float,
    boxes: FloatArray,
    seen: BoolArray,
    met: IntArray,
) -> None:
    """Where the ego with its buffer is on each lane, at each of the first `count` places of a path (K, 4).

    Parameters
    ----------
    period : of a frame [s].
    boxes : (n, K, 4), written: the least and the greatest s and r of it [m]; the first is `FAR_OFF` where it is not
        near. seen : (n, K), written: whether it drives in the lane, in its direction, where others in it see it.
    met : the first and the last frame in which it is near, (n, 2), written; the last before the first for never.
    """
    reach = math.hypot(body.along, body.across) + _NEAR
    for lane in range(circles.shape[0]):
        met[lane, 0], met[lane, 1] = count, -1
        length, curved = lanes.rows[lane, LANE_LENGTH], lanes.ids[lane, SHAPE] == CIRCULAR
        # Between two points that are looked at, a side that is straight comes nearer to the middle of an arc.
        bulge = body.along * body.along / (8 * lanes.rows[lane, RADIUS]) if curved else 0.0
        for k in range(count):
            x, y = path[k, 0], path[k, 1]
            box = boxes[lane, k]
            box[0], seen[lane, k] = FAR_OFF, False
            if math.hypot(x - circles[lane, 0], y - circles[lane, 1]) > circles[lane, 2] + reach:
                continue
            s, r = local(lanes, lane, x, y)
            if abs(r) > reach or s < -reach or s > length + reach:
                continue
            heading = path[k, 2]
            cos, sin = math.cos(heading), math.sin(heading)
            box[0], box[1], box[2], box[3] = s, s, r, r
            for j in range(9):
                if j == 4:
                    continue
                a, b = (j // 3 - 1) * body.along, (j % 3 - 1) * body.across
                at, off = local(lanes, lane, x + cos * a - sin * b, y + sin * a + cos * b)
                box[0], box[1] = min(box[0], at), max(box[1], at)
                box[2], box[3] = min(box[2], off), max(box[3], off)
            # highway-env counts a collision that constant velocities would bring within the coming frame.
            way = path[k, 3] * period
            for j in range(4):
                a, b = (2 * (j // 2) - 1) * body.length + way, (2 * (j % 2) - 1) * body.width
                at, off = local(lanes, lane, x + cos * a - sin * b, y + sin * a + cos * b)
                box[0], box[1] = min(box[0], at), max(box[1], at)
                box[2], box[3] = min(box[2], off), max(box[3], off)
            box[2] -= bulge
            box[3] += bulge
            met[lane, 0], met[lane, 1] = min(met[lane, 0], k), k
            along = math.cos(wrap_to_pi(heading - heading_at(lanes, lane, min(max(s, 0.0), length))))
            seen[lane, k] = abs(r) <= body.visible and on_lane(lanes.rows, lane, s, 0.0, 0.0) and along >= _WITH
