"""The extent of a rectangle on a lane: the least and the greatest s and r of its points.

Notation
--------
As in `dynamics.road_networks.geometry.lanes`. A rectangle is given relative to a *place* with known s and r. On a sine,
r is measured across the line that the sine winds around, so it grows with the slope of the lane.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.road_networks.geometry.lanes import NetworkLanes
from dynamics.road_networks.geometry.layout import (
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
from dynamics.state import FloatArray

__all__ = ["Extent", "LanePoint", "Rectangle", "extent_of"]


class LanePoint(NamedTuple):
    """A point in the world frame, and its s and r on a lane [m]."""

    x: float
    y: float
    s: float
    r: float


class Rectangle(NamedTuple):
    """A rectangle: how far its centre is ahead of a place [m], the cosine and sine of its heading, and half of its
    sides [m]."""

    ahead: float
    cos: float
    sin: float
    length: float
    width: float


class Extent(NamedTuple):
    """The least and the greatest s and r of a set of points [m]."""

    first: float
    last: float
    low: float
    high: float


@kernel_inline
def _direction(row: FloatArray, body: Rectangle) -> tuple[float, float]:
    """Components of a rectangle's direction along and across a line."""
    along = body.cos * row[ALONG_X] + body.sin * row[ALONG_Y]
    return along, body.cos * row[ACROSS_X] + body.sin * row[ACROSS_Y]


@kernel_inline
def _on_line(row: FloatArray, at: LanePoint, body: Rectangle) -> Extent:
    """The extent on a straight lane."""
    along, across = _direction(row, body)
    ds = abs(along) * body.length + abs(across) * body.width
    dr = abs(across) * body.length + abs(along) * body.width
    s, r = at.s + along * body.ahead, at.r + across * body.ahead
    return Extent(s - ds, s + ds, r - dr, r + dr)


@kernel_no_refcount
def _on_arc(row: FloatArray, at: LanePoint, body: Rectangle) -> Extent:
    """The extent on an arc. Angles and the greatest distance from the centre are extreme at corners. The least distance
    may be on a side."""
    sign, radius = row[DIRECTION], row[RADIUS]
    dx, dy = row[ORIGIN_X] - at.x, row[ORIGIN_Y] - at.y
    # The centre of the arc relative to the place, along and across the rectangle; w is relative to the rectangle's
    # centre.
    u, v = dx * body.cos + dy * body.sin, dy * body.cos - dx * body.sin
    w = u - body.ahead
    near = math.hypot(max(abs(w) - body.length, 0.0), max(abs(v) - body.width, 0.0))
    far = math.hypot(abs(w) + body.length, abs(v) + body.width)
    low, high, wide = math.inf, -math.inf, False
    if abs(v) <= body.width and abs(u) <= body.length + abs(body.ahead):
        low, high = -math.pi, math.pi
    else:
        for k in range(4):
            a, b = (body.length if k < 2 else -body.length) - w, (body.width if k % 2 == 0 else -body.width) - v
            off, cosine = v * a - u * b, -u * a - v * b
            wide = wide or not cosine > 0.0
            # The tangent is monotonic in the angle below a right angle, and cheaper than the angle.
            low, high = min(low, off / cosine), max(high, off / cosine)
        low, high = math.atan(low), math.atan(high)
    if wide:
        low, high = math.inf, -math.inf
        for k in range(4):
            a, b = (body.length if k < 2 else -body.length) - w, (body.width if k % 2 == 0 else -body.width) - v
            angle = math.atan2(v * a - u * b, -u * a - v * b)
            low, high = min(low, angle), max(high, angle)
    one, other = sign * low * radius, sign * high * radius
    inside, outside = sign * (radius - near), sign * (radius - far)
    return Extent(at.s + min(one, other), at.s + max(one, other), min(inside, outside), max(inside, outside))


@kernel_no_refcount
def _bulges(row: FloatArray, s: float, q: float, ds: float, dq: float) -> tuple[float, float]:
    """The least and the greatest r at which a segment is parallel to a sine; infinite where there is none.

    Parameters
    ----------
    s, q : start of the segment, along and across the line that the sine winds around [m].
    ds, dq : vector to its end [m].
    """
    swing, rate, phase, low, high = row[AMPLITUDE], row[PULSATION], row[PHASE], math.inf, -math.inf
    if abs(dq) < abs(swing * rate * ds):
        cosine = dq / (swing * rate * ds)
        steep, sine = math.acos(cosine), math.sqrt(1 - cosine * cosine)
        one, other = rate * s + phase, rate * (s + ds) + phase
        for sign in (-1.0, 1.0):
            turn = math.ceil((min(one, other) - sign * steep) / (2 * math.pi))
            while sign * steep + 2 * math.pi * turn <= max(one, other):
                share = (sign * steep + 2 * math.pi * turn - one) / (other - one)
                r = q + share * dq - swing * sign * sine
                low, high, turn = min(low, r), max(high, r), turn + 1
    return low, high


@kernel_no_refcount
def _on_sine(row: FloatArray, at: LanePoint, body: Rectangle) -> Extent:
    """The extent on a sine: r is extreme at a corner, or where a side is parallel to the sine."""
    along, across = _direction(row, body)
    swing, rate, phase = row[AMPLITUDE], row[PULSATION], row[PHASE]
    s = at.s + along * body.ahead
    q = at.r + swing * math.sin(rate * at.s + phase) + across * body.ahead
    long_s, long_q, wide_s, wide_q = along * body.length, across * body.length, -across * body.width, along * body.width
    low, high = math.inf, -math.inf
    for k in range(4):
        a, b = (1.0 if k < 2 else -1.0), (1.0 if k % 3 == 0 else -1.0)
        corner_s, corner_q = s + a * long_s + b * wide_s, q + a * long_q + b * wide_q
        r = corner_q - swing * math.sin(rate * corner_s + phase)
        # Sides of the rectangle in order, alternately across and along it.
        ds, dq = (-2 * b * wide_s, -2 * b * wide_q) if k % 2 == 0 else (-2 * a * long_s, -2 * a * long_q)
        least, most = _bulges(row, corner_s, corner_q, ds, dq)
        low, high = min(low, min(r, least)), max(high, max(r, most))
    reach = abs(long_s) + abs(wide_s)
    return Extent(s - reach, s + reach, low, high)


@kernel_no_refcount
def extent_of(lanes: NetworkLanes, lane: int, at: LanePoint, body: Rectangle) -> Extent:
    """The extent of a rectangle on a lane. If it contains the centre of an arc, s spans the whole circle."""
    row, shape = lanes.rows[lane], lanes.ids[lane, SHAPE]
    if shape == CIRCULAR:
        return _on_arc(row, at, body)
    return _on_sine(row, at, body) if shape == SINE else _on_line(row, at, body)
