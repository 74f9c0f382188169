"""Computations of the report's published script, with its mistakes.

Observations are those of highway-env's Kinematics: rows (..., n, f), the ego's first, with the features presence, x, y,
vx and vy. They are normalised: 1 is 200 m of x, 4 m times the lanes of y, and 80 m/s of vx and vy. Others are relative
to the ego. The functions take any number of environments, in the leading axes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics.state import BoolArray, FloatArray, IntArray

__all__ = [
    "GATE",
    "confidence_across_features",
    "counts_as_lane_change",
    "gate_skills",
    "intent_of_normalised",
    "noise_on_all_rows",
    "override_score",
    "overriding_action",
]

_STATE = slice(1, 5)
_VX, _VY = 3, 4
_REACH, _LEAST_SCORE = 3.0, 0.7
_IDLE, _FASTER, _SLOWER = 1, 3, 4
GATE = 0.65
"""Value of the last column of the ego's row below which a skill is replaced."""


def noise_on_all_rows(rows: NDArray[np.float32], draws: FloatArray, sigma: float) -> NDArray[np.float32]:
    """Add noise to x, y, vx and vy of all rows, including the ego's and absent ones, without clipping.

    Parameters
    ----------
    rows : observations, (..., n, 5).
    draws : samples of a standard normal distribution, (..., n, 4).
    sigma : standard deviation in normalised units.
    """
    shown = rows.copy()
    shown[..., _STATE] += (sigma * draws).astype(rows.dtype)
    return shown


def confidence_across_features(rows: NDArray[Any]) -> FloatArray:
    """exp(-variance) of the four numbers x, y, vx and vy of each row, (..., n).

    It is the population variance across features, not a variance over time. The uncertainty of a row enters it only
    through the noise of the same decision. Absent rows have a value too.
    """
    return np.asarray(np.exp(-np.asarray(rows[..., _STATE], float).var(axis=-1)))


def intent_of_normalised(rows: NDArray[Any], threshold: float = 0.3) -> FloatArray:
    """+1 or -1 by the sign of vy if its magnitude is above the threshold, else 0; (..., n).

    The threshold is meant in m/s but is compared with the normalised speed, where 0.3 is 24 m/s. So values above it are
    noise. Speeds of others are relative to the ego's.
    """
    vy = np.asarray(rows[..., _VY], float)
    return np.where(np.abs(vy) > threshold, np.sign(vy), 0.0)


def override_score(rows: NDArray[Any]) -> FloatArray:
    """Half of the last column of the ego's row plus half of a distance r, (...,).

    The script reads x, lane and speed one column too early: its x is the presence flag, and its lane is int(x). r is
    the least difference of its x to a vehicle in the ego's lane, from 0 to below 3, as a share of 3; it is 1 without
    one. As both flags are 1, r is 0 if a present vehicle has the same int(x), and 1 otherwise.
    """
    flag, lane = np.asarray(rows[..., 0], float), np.trunc(rows[..., 1])
    ahead = flag[..., 1:] - flag[..., :1]
    near = (lane[..., 1:] == lane[..., :1]) & (ahead >= 0.0) & (ahead < _REACH)
    least = np.where(near, ahead, _REACH).min(axis=-1)
    found: FloatArray = 0.5 * np.asarray(rows[..., 0, -1], float) + 0.5 * np.clip(least / _REACH, 0.0, 1.0)
    return found


def overriding_action(rows: NDArray[Any], actions: IntArray) -> tuple[IntArray, BoolArray]:
    """The executed action for each proposal, and whether the rule replaced it, (...,).

    If `override_score` is at most 0.7, every proposal is replaced: by FASTER if the ego's "speed" is below 0.5, by
    SLOWER if it is above 1, else by IDLE. That speed is the column y.
    """
    speed = np.asarray(rows[..., 0, 2], float)
    acts = override_score(rows) <= _LEAST_SCORE
    safe = np.where(speed < 0.5, _FASTER, np.where(speed > 1.0, _SLOWER, _IDLE))
    return np.where(acts, safe, actions), acts


def gate_skills(rows: NDArray[Any], skills: IntArray, slow_down: int) -> tuple[IntArray, BoolArray]:
    """The skill to begin for each proposal, and whether it was gated, (...,).

    It is `slow_down` if the last column of the ego's row is below `GATE`. The gate applies at the start of a skill
    only.
    """
    acts = np.asarray(rows[..., 0, -1]) < GATE
    return np.where(acts, slow_down, skills), acts


def counts_as_lane_change(rows: NDArray[Any]) -> BoolArray:
    """Whether the script counts a decision as a lane change, (...,).

    Its condition is |vx| > 0.2 (16 m/s) of the ego, its speed along the road. Nearly all decisions fulfil it.
    """
    return np.asarray(np.abs(rows[..., 0, _VX]) > 0.2)
