"""Positions of many points on the lanes of a network: loops over arrays of equal length, (k,)."""

from __future__ import annotations

import math

import numpy as np

from dynamics.compiled import kernel_no_refcount
from dynamics.highway_simulator.layout import LANE_LENGTH
from dynamics.road_networks.geometry.lanes import NetworkLanes, closest, heading_at, local, place
from dynamics.road_networks.geometry.layout import (
    ACROSS_X,
    ACROSS_Y,
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
from dynamics.state import FloatArray, IntArray

__all__ = ["circles_of", "closest_all", "curvature_all", "heading_all", "position_all", "project_all"]

_SAMPLES = 9
"""Number of points of a lane from which its enclosing circle is computed."""


@kernel_no_refcount
def circles_of(lanes: NetworkLanes, circles: FloatArray) -> None:
    """A circle around the centre line of each lane: x, y and radius [m], (n, 3), written."""
    for lane in range(circles.shape[0]):
        length, low_x, low_y, high_x, high_y = lanes.rows[lane, LANE_LENGTH], np.inf, np.inf, -np.inf, -np.inf
        for k in range(_SAMPLES):
            x, y = place(lanes, lane, length * k / (_SAMPLES - 1))
            low_x, low_y, high_x, high_y = min(low_x, x), min(low_y, y), max(high_x, x), max(high_y, y)
        circles[lane, 0], circles[lane, 1] = 0.5 * (low_x + high_x), 0.5 * (low_y + high_y)
        # Every point of the lane is within half the spacing of a sample.
        circles[lane, 2] = 0.5 * math.hypot(high_x - low_x, high_y - low_y) + 0.6 * length / (_SAMPLES - 1)


@kernel_no_refcount
def project_all(
    lanes: NetworkLanes, numbers: IntArray, x: FloatArray, y: FloatArray, s: FloatArray, r: FloatArray
) -> None:
    """(s, r) of points on lanes [m], written."""
    for k in range(numbers.size):
        s[k], r[k] = local(lanes, numbers[k], x[k], y[k])


@kernel_no_refcount
def position_all(
    lanes: NetworkLanes, numbers: IntArray, s: FloatArray, r: FloatArray, x: FloatArray, y: FloatArray
) -> None:
    """(x, y) of places on lanes [m], written."""
    for k in range(numbers.size):
        row = lanes.rows[numbers[k]]
        x[k], y[k] = place(lanes, numbers[k], s[k])
        across_x, across_y = row[ACROSS_X], row[ACROSS_Y]
        if lanes.ids[numbers[k], SHAPE] == CIRCULAR:
            # For a vehicle that drives clockwise, the centre of the arc is to the right.
            across_x = row[DIRECTION] * (row[ORIGIN_X] - x[k]) / row[RADIUS]
            across_y = row[DIRECTION] * (row[ORIGIN_Y] - y[k]) / row[RADIUS]
        x[k] += r[k] * across_x
        y[k] += r[k] * across_y


@kernel_no_refcount
def heading_all(lanes: NetworkLanes, numbers: IntArray, s: FloatArray, out: FloatArray) -> None:
    """Headings of lanes at s [rad], written."""
    for k in range(numbers.size):
        out[k] = heading_at(lanes, numbers[k], s[k])


@kernel_no_refcount
def curvature_all(lanes: NetworkLanes, numbers: IntArray, s: FloatArray, out: FloatArray) -> None:
    """Curvatures of lanes at s [rad/m], written: per length of the centre line itself, for a sine too."""
    for k in range(numbers.size):
        row, shape = lanes.rows[numbers[k]], lanes.ids[numbers[k], SHAPE]
        out[k] = 0.0
        if shape == CIRCULAR:
            out[k] = row[DIRECTION] / row[RADIUS]
        elif shape == SINE:
            phase = row[PULSATION] * s[k] + row[PHASE]
            slope = row[AMPLITUDE] * row[PULSATION] * math.cos(phase)
            bend = -row[AMPLITUDE] * row[PULSATION] * row[PULSATION] * math.sin(phase)
            out[k] = bend / (1 + slope * slope) ** 1.5


@kernel_no_refcount
def closest_all(
    lanes: NetworkLanes,
    x: FloatArray,
    y: FloatArray,
    heading: FloatArray,
    found: IntArray,
    s: FloatArray,
    r: FloatArray,
) -> None:
    """The lanes nearest in position and heading, and (s, r) on them [m], written."""
    guess = 0
    for k in range(found.size):
        guess, s[k], r[k] = closest(lanes, x[k], y[k], heading[k], guess)
        found[k] = guess
