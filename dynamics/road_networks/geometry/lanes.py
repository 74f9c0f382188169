"""Positions on a lane: highway-env's `StraightLane`, `SineLane` and `CircularLane`.

Notation
--------
On a lane, s [m] is the distance along its centre line from its start, negative before it. r [m] is the distance across,
positive to the right in the direction of travel (highway-env's y points down).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.arithmetic import dot2, wrap_to_pi
from dynamics.highway_simulator.lanes import OVERHANG
from dynamics.highway_simulator.layout import LANE_LENGTH, LANE_WIDTH
from dynamics.highway_simulator.loops import at, at_two
from dynamics.road_networks.geometry.layout import (
    ACROSS_X,
    ACROSS_Y,
    ALONG_X,
    ALONG_Y,
    AMPLITUDE,
    CIRCULAR,
    DIRECTION,
    FORBIDDEN,
    LANE_HEADING,
    LEAST_X,
    LEAST_Y,
    MOST_X,
    MOST_Y,
    ORIGIN_X,
    ORIGIN_Y,
    PHASE,
    PULSATION,
    QUARTER,
    RADIUS,
    REACH,
    SHAPE,
    SINE,
)
from dynamics.state import FloatArray, IntArray

__all__ = [
    "NetworkLanes",
    "after_end",
    "closest",
    "distance",
    "heading_at",
    "least_across",
    "local",
    "on_lane",
    "place",
    "reachable",
    "straight",
    "unrolled",
]

_ARCTAN, _COS, _SIN, _ARCTAN2 = 1, 3, 4, 7
_ROUNDING = 1e-9
"""Bound on the rounding error of a distance [m]."""


class NetworkLanes(NamedTuple):
    """The lanes of a network, and how numpy computes on this machine (see
    `dynamics.highway_simulator.arrays.Machine`).

    Attributes
    ----------
    rows, ids : (n, COLUMNS) and (n, IDS), see `layout`. near : (n, most), see `network.Network`.
    """

    sums: int
    loops: IntArray
    rows: FloatArray
    ids: IntArray
    near: IntArray


@kernel_inline
def _on_arc(row: FloatArray, radius: float, polar: float) -> tuple[float, float]:
    """(s, r) on an arc [m] from polar coordinates around its centre [m, rad]."""
    start = row[PHASE]
    phi = start + wrap_to_pi(polar - start)
    return row[DIRECTION] * (phi - start) * row[RADIUS], row[DIRECTION] * (row[RADIUS] - radius)


@kernel_inline
def straight(sums: int, row: FloatArray, x: float, y: float) -> tuple[float, float]:
    """(s, r) of a point on a straight lane; for a sine, along and across the line that it winds around [m]."""
    dx, dy = x - row[ORIGIN_X], y - row[ORIGIN_Y]
    return dot2(sums, dx, row[ALONG_X], dy, row[ALONG_Y]), dot2(sums, dx, row[ACROSS_X], dy, row[ACROSS_Y])


@kernel_inline
def _polar(lanes: NetworkLanes, dx: float, dy: float) -> tuple[float, float]:
    """Polar coordinates of a point relative to a centre [m, rad]."""
    radius = math.sqrt(dot2(lanes.sums, dx, dx, dy, dy))
    return radius, at_two(lanes.loops[_ARCTAN2, 0], lanes.loops[_ARCTAN2, 1], dy, dx)


@kernel_no_refcount
def local(lanes: NetworkLanes, lane: int, x: float, y: float) -> tuple[float, float]:
    """(s, r) of a point on a lane [m]."""
    row = lanes.rows[lane]
    if lanes.ids[lane, SHAPE] == CIRCULAR:
        radius, polar = _polar(lanes, x - row[ORIGIN_X], y - row[ORIGIN_Y])
        return _on_arc(row, radius, polar)
    s, r = straight(lanes.sums, row, x, y)
    if lanes.ids[lane, SHAPE] == SINE:
        r -= row[AMPLITUDE] * at(lanes.loops[_SIN, 0], lanes.loops[_SIN, 1], row[PULSATION] * s + row[PHASE])
    return s, r


@kernel_inline
def unrolled(lanes: NetworkLanes, lane: int, s: float) -> float:
    """The same place with s within half a circle of the middle of an arc [m]. highway-env's s jumps back by a circle at
    half a circle after the start, where the lane of a u-turn ends."""
    if lanes.ids[lane, SHAPE] != CIRCULAR:
        return s
    half = math.pi * lanes.rows[lane, RADIUS]
    return s + 2 * half if s < 0.5 * lanes.rows[lane, LANE_LENGTH] - half else s


@kernel_no_refcount
def least_across(lanes: NetworkLanes, lane: int, x: float, y: float) -> float:
    """Lower bound on |r| of a point on a lane [m], without computing an angle."""
    row = lanes.rows[lane]
    dx, dy = x - row[ORIGIN_X], y - row[ORIGIN_Y]
    if lanes.ids[lane, SHAPE] == CIRCULAR:
        return abs(row[DIRECTION] * (row[RADIUS] - math.sqrt(dot2(lanes.sums, dx, dx, dy, dy))))
    r = abs(dot2(lanes.sums, dx, row[ACROSS_X], dy, row[ACROSS_Y]))
    return r - abs(row[AMPLITUDE]) - _ROUNDING if lanes.ids[lane, SHAPE] == SINE else r


@kernel_inline
def heading_at(lanes: NetworkLanes, lane: int, s: float) -> float:
    """Heading of a lane at s [rad]."""
    row = lanes.rows[lane]
    if lanes.ids[lane, SHAPE] == CIRCULAR:
        return row[DIRECTION] * s / row[RADIUS] + row[PHASE] + row[QUARTER]
    if lanes.ids[lane, SHAPE] == SINE:
        cos = at(lanes.loops[_COS, 0], lanes.loops[_COS, 1], row[PULSATION] * s + row[PHASE])
        slope = row[AMPLITUDE] * row[PULSATION] * cos
        return row[LANE_HEADING] + at(lanes.loops[_ARCTAN, 0], lanes.loops[_ARCTAN, 1], slope)
    return row[LANE_HEADING]


@kernel_no_refcount
def place(lanes: NetworkLanes, lane: int, s: float) -> tuple[float, float]:
    """The point of a lane's centre line at s [m]."""
    row = lanes.rows[lane]
    if lanes.ids[lane, SHAPE] == CIRCULAR:
        phi = row[DIRECTION] * s / row[RADIUS] + row[PHASE]
        cos, sin = (
            at(lanes.loops[_COS, 0], lanes.loops[_COS, 1], phi),
            at(lanes.loops[_SIN, 0], lanes.loops[_SIN, 1], phi),
        )
        return row[ORIGIN_X] + row[RADIUS] * cos, row[ORIGIN_Y] + row[RADIUS] * sin
    r = 0.0
    if lanes.ids[lane, SHAPE] == SINE:
        r = row[AMPLITUDE] * at(lanes.loops[_SIN, 0], lanes.loops[_SIN, 1], row[PULSATION] * s + row[PHASE])
    x = row[ORIGIN_X] + s * row[ALONG_X] + r * row[ACROSS_X]
    return x, row[ORIGIN_Y] + s * row[ALONG_Y] + r * row[ACROSS_Y]


@kernel_inline
def on_lane(rows: FloatArray, lane: int, s: float, r: float, margin: float) -> bool:
    """Whether a place is on a lane, or no further beyond its edges than the margin [m]."""
    return abs(r) <= rows[lane, LANE_WIDTH] / 2 + margin and -OVERHANG <= s < rows[lane, LANE_LENGTH] + OVERHANG


@kernel_no_refcount
def reachable(lanes: NetworkLanes, lane: int, x: float, y: float) -> bool:
    """Whether a lane may be chosen from a place."""
    if lanes.ids[lane, FORBIDDEN]:
        return False
    s, r = local(lanes, lane, x, y)
    return abs(r) <= 2 * lanes.rows[lane, LANE_WIDTH] and 0 <= s < lanes.rows[lane, LANE_LENGTH] + OVERHANG


@kernel_inline
def after_end(rows: FloatArray, lane: int, s: float) -> bool:
    """Whether a lane has been driven to its end."""
    return s > rows[lane, LANE_LENGTH] - OVERHANG / 2


@kernel_no_refcount
def distance(lanes: NetworkLanes, lane: int, x: float, y: float) -> float:
    """highway-env's distance from a point to a lane [m]: across, and along beyond its ends."""
    s, r = local(lanes, lane, x, y)
    return abs(r) + max(s - lanes.rows[lane, LANE_LENGTH], 0.0) + max(0.0 - s, 0.0)


@kernel_inline
def _away(lanes: NetworkLanes, lane: int, s: float, r: float, heading: float) -> float:
    """highway-env's `distance_with_heading` from a place on a lane."""
    angle = abs(wrap_to_pi(heading - heading_at(lanes, lane, s)))
    return abs(r) + max(s - lanes.rows[lane, LANE_LENGTH], 0.0) + max(0.0 - s, 0.0) + 1.0 * angle


@kernel_inline
def _within(row: FloatArray, x: float, y: float, limit: float) -> bool:
    """Whether a point is within `limit` of the bounding box of a lane [m]."""
    across = row[LEAST_X] - limit <= x <= row[MOST_X] + limit
    return across and row[LEAST_Y] - limit <= y <= row[MOST_Y] + limit


@kernel_inline
def closest(lanes: NetworkLanes, x: float, y: float, heading: float, guess: int) -> tuple[int, float, float]:
    """The lane nearest in position and heading, the first among equals, and (s, r) on it [m]. A good guess saves most
    of the work."""
    # Arcs of one roundabout share a centre, and so the polar coordinates of the point.
    known, radius, polar, center_x, center_y = False, 0.0, 0.0, math.nan, math.nan
    row = lanes.rows[guess]
    if lanes.ids[guess, SHAPE] == CIRCULAR:
        center_x, center_y = row[ORIGIN_X], row[ORIGIN_Y]
        known, (radius, polar) = True, _polar(lanes, x - center_x, y - center_y)
        along, across = _on_arc(row, radius, polar)
    else:
        along, across = local(lanes, guess, x, y)
    guessed = limit = _away(lanes, guess, along, across, heading)
    best, least, guess_along, guess_across = guess, math.inf, along, across
    # If the point is within `REACH` of the box of the guessed lane, only lanes near that lane can be nearer.
    known_near = limit <= REACH and _within(lanes.rows[guess], x, y, REACH)
    for j in range(lanes.near.shape[1] if known_near else len(lanes.rows)):
        lane = lanes.near[guess, j] if known_near else j
        if lane < 0:
            break
        row = lanes.rows[lane]
        # The distance to the bounding box of a lane is a lower bound on the distance to the lane.
        if not _within(row, x, y, limit):
            continue
        if lane == guess:
            s, r, away = guess_along, guess_across, guessed
        elif lanes.ids[lane, SHAPE] == CIRCULAR:
            if not (known and row[ORIGIN_X] == center_x and row[ORIGIN_Y] == center_y):
                center_x, center_y = row[ORIGIN_X], row[ORIGIN_Y]
                known, (radius, polar) = True, _polar(lanes, x - center_x, y - center_y)
            s, r = _on_arc(row, radius, polar)
            away = _away(lanes, lane, s, r, heading)
        else:
            s, r = local(lanes, lane, x, y)
            away = _away(lanes, lane, s, r, heading)
        if away < least:
            best, least, along, across = lane, away, s, r
            limit = min(limit, least)
    return best, along, across
