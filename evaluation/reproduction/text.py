"""Formulas of the report's text where its script differs (see `evaluation.reproduction.script`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics.state import BoolArray, FloatArray, IntArray

__all__ = [
    "HIGHWAY",
    "ROUNDABOUT",
    "ConfidenceOverTime",
    "Scale",
    "intent_in_metres",
    "noise_on_others",
    "override_lane_changes",
    "vehicle_near",
]

_STATE = slice(1, 5)
_LEFT, _RIGHT, _SLOWER = 0, 2, 4


@dataclass(frozen=True)
class Scale:
    """Scale of an observation: the quantity that a value of 1 stands for.

    Attributes
    ----------
    x, y : position [m].
    speed : vx and vy [m/s].
    relative : whether the others' rows are relative to the ego's, and x is along the road. Otherwise the distance along
        the road is that of the centres, because the road is round.
    """

    x: float
    y: float
    speed: float
    relative: bool

    def offsets(self, rows: NDArray[Any]) -> tuple[FloatArray, FloatArray]:
        """x and y of the others relative to the ego [m], (..., n - 1) each."""
        shown = np.asarray(rows[..., 1:3], float)
        others = shown[..., 1:, :] if self.relative else shown[..., 1:, :] - shown[..., :1, :]
        return self.x * others[..., 0], self.y * others[..., 1]


HIGHWAY = Scale(200.0, 16.0, 80.0, True)
"""Scale of highway-env's highway of four lanes."""
ROUNDABOUT = Scale(100.0, 100.0, 15.0, False)
"""Scale of highway-env's roundabout."""


def noise_on_others(rows: NDArray[np.float32], draws: FloatArray, sigma: float) -> NDArray[np.float32]:
    """Add noise to x, y, vx and vy of the other vehicles that are present.

    Parameters
    ----------
    rows : normalised observations, (..., n, 5).
    draws : samples of a standard normal distribution, (..., n, 4).
    sigma : standard deviation in normalised units.
    """
    shown = rows.copy()
    present = rows[..., :1] > 0
    present[..., 0, :] = False
    shown[..., _STATE] += np.where(present, sigma * draws, 0.0).astype(rows.dtype)
    return shown


def intent_in_metres(rows: NDArray[Any], threshold: float = 0.3, scale: Scale = HIGHWAY) -> FloatArray:
    """+1 for a motion towards +y (on a highway to the right) of more than `threshold` [m/s], -1 for the opposite, else
    0.

    The shape is (..., n); an absent row has 0.
    """
    vy = scale.speed * np.asarray(rows[..., 4], float)
    if scale.relative:
        vy[..., 1:] += vy[..., :1]
    return np.where((np.abs(vy) > threshold) & (np.asarray(rows[..., 0]) > 0), np.sign(vy), 0.0)


class ConfidenceOverTime:
    """exp(-Var) of each row, for a batch; `evaluation.wrappers.Confidence` is the same for one environment.

    Var is the sum of the variances of x, y, vx and vy over the last decisions in which the row was not empty.

    Parameters
    ----------
    envs : number of environments.
    rows : number of rows of an observation.
    window : number of decisions.
    """

    def __init__(self, envs: int, rows: int, window: int = 5) -> None:
        self._past = np.full((window, envs, rows, 4), np.nan)

    def begin(self, e: int) -> None:
        """Forget the past observations of an environment."""
        self._past[:, e] = np.nan

    def add(self, rows: NDArray[Any], which: IntArray) -> FloatArray:
        """Add observations (k, n, 5) of the environments `which` (k,), and return the confidence of each row, (k, n).

        An absent row has 0.
        """
        there = rows[..., :1] > 0
        self._past[:-1, which] = self._past[1:, which]
        self._past[-1, which] = np.where(there, rows[..., _STATE], np.nan)
        past = self._past[:, which]
        known = ~np.isnan(past)
        count = np.maximum(known.sum(axis=0), 1)
        mean = np.where(known, past, 0.0).sum(axis=0) / count
        variances = np.where(known, np.square(past - mean), 0.0).sum(axis=0) / count
        return np.where(there[..., 0], np.exp(-variances.sum(axis=-1)), 0.0)


def override_lane_changes(
    rows: NDArray[Any], actions: IntArray, distance: float, scale: Scale = HIGHWAY
) -> tuple[IntArray, BoolArray]:
    """Replace lane changes by SLOWER while a vehicle is nearer along the road than `distance` [m].

    Returns
    -------
    The actions, and whether each was replaced, (...,).
    """
    x, y = scale.offsets(rows)
    along = np.where(rows[..., 1:, 0] > 0, np.abs(x) if scale.relative else np.hypot(x, y), np.inf)
    acts = ((actions == _LEFT) | (actions == _RIGHT)) & (along.min(axis=-1) < distance)
    return np.where(acts, _SLOWER, actions), acts


def vehicle_near(rows: NDArray[Any], distance: float, scale: Scale = HIGHWAY) -> BoolArray:
    """Whether a vehicle is shown nearer to the ego than `distance` [m], (...,)."""
    x, y = scale.offsets(rows)
    apart = np.where(rows[..., 1:, 0] > 0, np.hypot(x, y), np.inf)
    return np.asarray(apart.min(axis=-1) < distance)
