"""Clause of room: a plan stops inside one lane. Also the margin over all clauses."""

from __future__ import annotations

import math

import numpy as np

from dynamics.compiled import kernel_inline
from dynamics.state import FloatArray
from shield.certificate.road.clauses.footprint import Footprint

__all__ = ["margin_of", "room_of"]


@kernel_inline
def room_of(
    path: FloatArray,
    turned: FloatArray,
    size: Footprint,
    center: float,
    side: float,
    overshoot: float,
) -> float:
    """Room beside the ego with its buffer in the lane that a path (K, 4) stops in [m]; negative if it reaches out of
    the lane.

    Parameters
    ----------
    turned, size : as in `extents`. center, side : the lane's centre and half its width [m].
    overshoot : how far vehicles in the lanes beside may leave their bend by a frame of straight motion [m]; negative on
        a straight road.
    """
    last = path.shape[0] - 1
    sin, cos = abs(turned[0, last]), abs(turned[1, last])
    if overshoot < 0:
        half = size.along * sin + size.across * cos
    else:
        # On a curve, the buffer ahead and behind follows the lane: only the body has to fit.
        across = max(size.across, 0.5 * size.width + overshoot)
        half = 0.5 * size.length * sin + across * cos + size.body_growth_across
    return side - abs(path[last, 1] - center) - half


@kernel_inline
def margin_of(separations: FloatArray, cutting_in: FloatArray, room: float) -> float:
    """Margin of a path: its least separation, or the room if that is negative and less [m]; NaN if any input is NaN.

    Parameters
    ----------
    separations, cutting_in : from the vehicles in reach, (m,), and from those that may cut in, (q,) [m]. room : [m].
    """
    least, known = np.inf, not math.isnan(room)
    if room < 0:
        least = room
    for j in range(separations.shape[0]):
        known = known and not math.isnan(separations[j])
        least = min(least, separations[j])
    for j in range(cutting_in.shape[0]):
        known = known and not math.isnan(cutting_in[j])
        least = min(least, cutting_in[j])
    return least if known else np.nan
