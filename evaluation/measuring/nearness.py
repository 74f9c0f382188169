"""How near others come in time: time to collision at constant velocities, and time headway."""

from __future__ import annotations

import numpy as np

from dynamics.state import FloatArray
from evaluation.measuring.tally import HORIZON

__all__ = ["headways", "times_to_collision"]

_LEAST_SPEED = 0.1
"""Slower than this an ego has no headway [m/s]."""


def times_to_collision(ego: FloatArray, others: FloatArray) -> FloatArray:
    """Time until each other overlaps the ego at constant velocities, each as the upright rectangle around it, at most
    `evaluation.measuring.tally.HORIZON` [s]; as `evaluation.measuring.tally.time_to_collision` of single rows.

    Parameters
    ----------
    ego : x, y [m], heading [rad], speed [m/s], length, width [m] in the world frame, (..., 1, 6). others : (..., m, 6).

    Returns
    -------
    (..., m).
    """
    shape = np.broadcast_shapes(ego.shape[:-1], others.shape[:-1])
    least, most = np.zeros(shape), np.full(shape, HORIZON)
    turns = [(np.cos(rows[..., 2]), np.sin(rows[..., 2])) for rows in (ego, others)]
    for axis in range(2):
        half, speed = np.zeros(shape), np.zeros(shape)
        for rows, turn, sign in ((ego, turns[0], -1.0), (others, turns[1], 1.0)):
            along, across = turn if axis == 0 else turn[::-1]
            half = half + 0.5 * (rows[..., 4] * np.abs(along) + rows[..., 5] * np.abs(across))
            speed = speed + sign * rows[..., 3] * along
        offset = others[..., axis] - ego[..., axis]
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.sort(np.stack([(-half - offset) / speed, (half - offset) / speed]), axis=0)
        inside = np.where(np.abs(offset) < half, -np.inf, np.inf)
        still = np.abs(speed) < 1e-9
        least = np.maximum(least, np.where(still, inside, ends[0]))
        most = np.minimum(most, np.where(still, -inside, ends[1]))
    return np.where(least < most, least, HORIZON)


def headways(ego: FloatArray, others: FloatArray) -> FloatArray:
    """Time in which the ego comes to where the rear of each vehicle ahead in its way is now [s]; inf of those that are
    not ahead or beside its way, and where the ego hardly moves.

    Parameters
    ----------
    ego : s, r [m], heading [rad], speed [m/s], length, width [m] along a road, (..., 1, 6). others : (..., m, 6).

    Returns
    -------
    (..., m).
    """
    ahead = others[..., 0] - ego[..., 0]
    gap = ahead - 0.5 * (others[..., 4] + ego[..., 4])
    beside = np.abs(others[..., 1] - ego[..., 1]) >= 0.5 * (others[..., 5] + ego[..., 5])
    speed = np.broadcast_to(ego[..., 3], gap.shape)
    nobody = beside | (ahead <= 0) | (others[..., 4] <= 0) | (speed < _LEAST_SPEED)
    return np.where(nobody, np.inf, np.maximum(gap, 0.0) / np.maximum(speed, _LEAST_SPEED))
