"""Vehicle rows of tracked vehicles: at their estimated positions, or extended over all possible ones."""

from __future__ import annotations

import math

import numpy as np

from dynamics.compiled import kernel_no_refcount
from dynamics.state import FloatArray, Vehicle

__all__ = ["STANDING", "bodies", "bounded", "unseen_bodies"]

STANDING = 0.05
"""Below this speed [m/s] a velocity determines no heading."""
_X, _Y, _HEADING, _SPEED = int(Vehicle.X), int(Vehicle.Y), int(Vehicle.HEADING), int(Vehicle.SPEED)
_LENGTH, _WIDTH, _CRASHED, _COLUMNS = int(Vehicle.LENGTH), int(Vehicle.WIDTH), int(Vehicle.CRASHED), len(Vehicle)


def bodies(states: FloatArray, body: tuple[float, float]) -> FloatArray:
    """Vehicle rows (n, 7) of states x, y, vx, vy (n, 4); a heading differs from the road's direction by at most a
    quarter turn.

    Parameters
    ----------
    body : length and width of each [m].
    """
    rows = np.zeros((len(states), _COLUMNS))
    _fill(states, body[0], body[1], rows)
    return rows


def bounded(mean: FloatArray, low: FloatArray, high: FloatArray, body: tuple[float, float], x: float) -> FloatArray:
    """Vehicle rows (n, 7) that cover all possible positions of the tracked vehicles.

    The conservative speed is the greatest possible behind the ego, and the least possible ahead of it.

    Parameters
    ----------
    mean, low, high : estimated states x, y, vx, vy, and their bounds, (n, 4) each.
    body : length and width of each [m]. x : of the ego [m].
    """
    states, rows = np.empty((len(mean), 4)), np.zeros((len(mean), _COLUMNS))
    _widen(mean, low, high, x, states)
    _fill(states, body[0], body[1], rows)
    _lengthen(low, high, rows)
    return rows


def unseen_bodies(states: FloatArray, body: tuple[float, float]) -> FloatArray:
    """Vehicle rows (n, 7) of states x, y, heading, speed (n, 4) in the world frame.

    Parameters
    ----------
    body : length and width of each [m].
    """
    rows = np.zeros((len(states), _COLUMNS))
    rows[:, :_LENGTH] = states
    rows[:, _LENGTH:_CRASHED] = body
    return rows


@kernel_no_refcount
def _widen(mean: FloatArray, low: FloatArray, high: FloatArray, x: float, states: FloatArray) -> None:
    for a in range(len(mean)):
        states[a, 2] = high[a, 2] if mean[a, 0] < x else low[a, 2]
        states[a, 3] = mean[a, 3]
        states[a, 0], states[a, 1] = 0.5 * (low[a, 0] + high[a, 0]), 0.5 * (low[a, 1] + high[a, 1])


@kernel_no_refcount
def _lengthen(low: FloatArray, high: FloatArray, rows: FloatArray) -> None:
    for a in range(len(rows)):
        rows[a, _LENGTH] += high[a, 0] - low[a, 0]
        rows[a, _WIDTH] += high[a, 1] - low[a, 1]


@kernel_no_refcount
def _fill(states: FloatArray, length: float, width: float, rows: FloatArray) -> None:
    for a in range(len(states)):
        x, y, vx, vy = states[a, 0], states[a, 1], states[a, 2], states[a, 3]
        size, sign = math.hypot(vx, vy), -1.0 if vx < 0.0 else 1.0
        rows[a, _X], rows[a, _Y], rows[a, _SPEED] = x, y, sign * size
        if size >= STANDING:
            rows[a, _HEADING] = math.atan2(sign * vy, sign * vx)
        rows[a, _LENGTH], rows[a, _WIDTH] = length, width
