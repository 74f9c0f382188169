"""Least clearance, time to collision and time headway over all frames of an episode."""

from __future__ import annotations

import math

import numpy as np

from dynamics.compiled import kernel_no_refcount
from dynamics.state import FloatArray
from evaluation.measuring.tally import HORIZON, distance, time_to_collision

__all__ = ["least_clearance", "least_headway", "least_time_to_collision"]

_LEAST_SPEED = 0.1
"""Speed of the ego below which it has no headway [m/s]."""
_ROUNDING = 1.0 + 1e-9


@kernel_no_refcount
def least_clearance(states: FloatArray) -> float:
    """Least distance between the ego and another body [m]; inf without others.

    Parameters
    ----------
    states : x, y [m], heading [rad], speed [m/s], length, width [m] and more, (frames, bodies, 6 or more); body 0 is
        the ego.
    """
    least = np.inf
    for k in range(states.shape[0]):
        ego = states[k, 0]
        own = 0.5 * math.hypot(ego[4], ego[5])
        for i in range(1, states.shape[1]):
            other = states[k, i]
            # The distance of the bodies is at least that of their circumscribed circles.
            reach = own + 0.5 * math.hypot(other[4], other[5])
            if math.hypot(other[0] - ego[0], other[1] - ego[1]) - reach < least:
                least = min(least, distance(ego, other))
    return least


@kernel_no_refcount
def least_time_to_collision(states: FloatArray) -> float:
    """Least `evaluation.measuring.tally.time_to_collision` of the ego in a frame, at most `HORIZON` [s].

    Parameters
    ----------
    states : as in `least_clearance`.
    """
    least = HORIZON
    for k in range(states.shape[0]):
        ego = states[k, 0]
        own = 0.5 * math.hypot(ego[4], ego[5])
        for i in range(1, states.shape[1]):
            other = states[k, i]
            # Upright rectangles are within the circles along each axis, and close at no more than both speeds together.
            reach = own + 0.5 * math.hypot(other[4], other[5])
            apart = max(abs(other[0] - ego[0]), abs(other[1] - ego[1])) - reach
            if apart <= _ROUNDING * least * (abs(ego[3]) + abs(other[3])):
                least = min(least, time_to_collision(ego, other))
    return least


@kernel_no_refcount
def least_headway(states: FloatArray) -> float:
    """Least time in which the ego reaches the present rear of a vehicle ahead in its path [s].

    It is inf if no vehicle is ahead in any frame in which the ego moves.

    Parameters
    ----------
    states : s, r [m] along a road, and further columns as in `least_clearance`.
    """
    least = np.inf
    for k in range(states.shape[0]):
        ego = states[k, 0]
        if ego[3] < _LEAST_SPEED:
            continue
        for i in range(1, states.shape[1]):
            other = states[k, i]
            ahead = other[0] - ego[0]
            if ahead > 0 and other[4] > 0 and abs(other[1] - ego[1]) < 0.5 * (other[5] + ego[5]):
                least = min(least, max(ahead - 0.5 * (other[4] + ego[4]), 0.0) / ego[3])
    return least
