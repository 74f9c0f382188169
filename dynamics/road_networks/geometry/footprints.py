"""What a rectangle fills of a lane: the least and the greatest s and r of all of its points.

Notation
--------
As in `dynamics.road_networks.geometry.lanes`. A rectangle is given about a *place*, of which s and r are known. On a
sine, r is measured across the line that the sine winds around, so that it grows with the slope of the lane.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from dynamics.compiled import inlined, uncounted
from dynamics.road_networks.geometry.lanes import Lanes
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

__all__ = ["Extent", "Place", "Rectangle", "extent_of"]


class Place(NamedTuple):
    """A point of the world, and where it is on a lane [m]."""

    x: float
    y: float
    s: float
    r: float


class Rectangle(NamedTuple):
    """A rectangle: how far its middle is ahead of a place [m], its direction, and half of its sides [m]."""

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


@inlined
def _direction(row: FloatArray, body: Rectangle) -> tuple[float, float]:
    """How far a metre along a rectangle leads along a line, and across it [m]."""
    along = body.cos * row[ALONG_X] + body.sin * row[ALONG_Y]
    return along, body.cos * row[ACROSS_X] + body.sin * row[ACROSS_Y]


@inlined
def _on_line(row: FloatArray, at: Place, body: Rectangle) -> Extent:
    along, across = _direction(row, body)
    ds = abs(along) * body.length + abs(across) * body.width
    dr = abs(across) * body.length + abs(along) * body.width
    s, r = at.s + along * body.ahead, at.r + across * body.ahead
    return Extent(s - ds, s + ds, r - dr, r + dr)


@uncounted
def _on_arc(row: FloatArray, at: Place, body: Rectangle) -> Extent:
    """Angles are extreme at corners, and so is the greatest distance from the centre; the least may be on a side."""
    sign, radius = row[DIRECTION], row[RADIUS]
    dx, dy = row[ORIGIN_X] - at.x, row[ORIGIN_Y] - at.y
    # The centre of the arc, as seen from the place along and across the rectangle, and from its middle.
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
            # As it grows with the angle, up to a right one, but without one.
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


@uncounted
def _bulges(row: FloatArray, s: float, q: float, ds: float, dq: float) -> tuple[float, float]:
    """The least and the greatest r where a segment is as steep as a sine: it begins at s and, across the line that the
    sine winds around, q, and leads so much further [m]. Infinite where it is so nowhere."""
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


@uncounted
def _on_sine(row: FloatArray, at: Place, body: Rectangle) -> Extent:
    """r is extreme at a corner, or where a side is as steep as the sine."""
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
        # From corner to corner, around the rectangle: across it and along it in turn.
        ds, dq = (-2 * b * wide_s, -2 * b * wide_q) if k % 2 == 0 else (-2 * a * long_s, -2 * a * long_q)
        least, most = _bulges(row, corner_s, corner_q, ds, dq)
        low, high = min(low, min(r, least)), max(high, max(r, most))
    reach = abs(long_s) + abs(wide_s)
    return Extent(s - reach, s + reach, low, high)


@uncounted
def extent_of(lanes: Lanes, lane: int, at: Place, body: Rectangle) -> Extent:
    """What a rectangle fills of a lane. Where it contains the centre of an arc, that is all of its length."""
    row, shape = lanes.rows[lane], lanes.ids[lane, SHAPE]
    if shape == CIRCULAR:
        return _on_arc(row, at, body)
    return _on_sine(row, at, body) if shape == SINE else _on_line(row, at, body)
