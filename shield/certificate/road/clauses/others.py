"""The vehicles around the ego, as a judgement of paths sees them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.compiled import inlined
from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.traffic.tables import Bodies

__all__ = ["TOUCH", "Others", "empty_others", "others_from"]

TOUCH = 1.0
"""How near to a lane's centre a body comes before it is in the way there [m]: half the width of a car."""


class Others(NamedTuple):
    """The vehicles around the ego, as a judgement of paths sees them, each (v,).

    `ahead` [m]: centre ahead of the ego's; `least` [m]: the same of the least place that the centre ever comes to;
    `size` [m]: how near it counts as touching; `behind`: whether its body is behind the ego with its buffer; `low`,
    `high` [m]: edges of the lanes that it touches; `lane`: the nearest; `r` [m], `across` [m/s]: where it is across the
    road, and its speed there; `held`: whether it is in a lane that the ego owns, or has been behind the ego in one and
    its strip is not left yet; `beside`, `comes` (lanes, v): which lanes its strip is beside, and which of these it may
    enter.
    """

    ahead: FloatArray
    least: FloatArray
    size: FloatArray
    behind: BoolArray
    low: FloatArray
    high: FloatArray
    lane: IntArray
    r: FloatArray
    across: FloatArray
    held: BoolArray
    beside: BoolArray
    comes: BoolArray


def empty_others(m: int, lanes: int) -> tuple[FloatArray, BoolArray]:
    """Arrays for what is known of m vehicles beyond their `Bodies`: numbers (5, m), and flags (2 + 2 lanes, m)."""
    return np.empty((5, m)), np.zeros((2 + 2 * lanes, m), np.bool_)


@inlined
def others_from(bodies: Bodies, numbers: FloatArray, flags: BoolArray) -> Others:
    """The rows of both arrays by their names."""
    ahead, least, size, r, across = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]
    behind, held, lanes = flags[0], flags[1], flags.shape[0] // 2 + 1
    beside, comes, lane = flags[2:lanes], flags[lanes:], bodies.lane
    return Others(ahead, least, size, behind, bodies.low, bodies.high, lane, r, across, held, beside, comes)
