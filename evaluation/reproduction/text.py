"""What the text of the report says, where its script computes something else (see `evaluation.reproduction.script`)."""

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
    "somebody_near",
]

_STATE = slice(1, 5)
_LEFT, _RIGHT, _SLOWER = 0, 2, 4


@dataclass(frozen=True)
class Scale:
    """What 1 stands for in an observation.

    Attributes
    ----------
    x, y : [m]. speed : of vx and vy [m/s].
    relative : whether the others' rows are relative to the ego's, and x is along the road. Else "along the road" is
        the distance between centres, as the road is round.
    """

    x: float
    y: float
    speed: float
    relative: bool

    def offsets(self, rows: NDArray[Any]) -> tuple[FloatArray, FloatArray]:
        """x and y of the others against the ego [m], (..., n - 1) each."""
        shown = np.asarray(rows[..., 1:3], float)
        others = shown[..., 1:, :] if self.relative else shown[..., 1:, :] - shown[..., :1, :]
        return self.x * others[..., 0], self.y * others[..., 1]


HIGHWAY = Scale(200.0, 16.0, 80.0, True)
"""highway-env's highway of four lanes."""
ROUNDABOUT = Scale(100.0, 100.0, 15.0, False)
"""highway-env's roundabout."""


def noise_on_others(rows: NDArray[np.float32], draws: FloatArray, sigma: float) -> NDArray[np.float32]:
    """Add noise to x, y, vx and vy of the others that are present.

    Parameters
    ----------
    rows : (..., n, 5), normalised. draws : (..., n, 4). sigma : in normalised units.
    """
    shown = rows.copy()
    present = rows[..., :1] > 0
    present[..., 0, :] = False
    shown[..., _STATE] += np.where(present, sigma * draws, 0.0).astype(rows.dtype)
    return shown


def intent_in_metres(rows: NDArray[Any], threshold: float = 0.3, scale: Scale = HIGHWAY) -> FloatArray:
    """+1 where somebody moves towards +y, on a highway to the right, by more than `threshold` [m/s], -1 to the other
    side, else 0, and 0 in an absent row; (..., n)."""
    vy = scale.speed * np.asarray(rows[..., 4], float)
    if scale.relative:
        vy[..., 1:] += vy[..., :1]
    return np.where((np.abs(vy) > threshold) & (np.asarray(rows[..., 0]) > 0), np.sign(vy), 0.0)


class ConfidenceOverTime:
    """exp(-Var) of each row, where Var is the sum of the variances of x, y, vx and vy over the last decisions in which
    the row was not empty: `evaluation.wrappers.Confidence` for many environments at once.

    Parameters
    ----------
    envs : environments. rows : of an observation. window : decisions.
    """

    def __init__(self, envs: int, rows: int, window: int = 5) -> None:
        self._past = np.full((window, envs, rows, 4), np.nan)

    def begin(self, e: int) -> None:
        """Forget what was shown in an environment."""
        self._past[:, e] = np.nan

    def add(self, rows: NDArray[Any], which: IntArray) -> FloatArray:
        """The confidence of each row, (k, n), with what is shown now in the environments `which` (k,), (k, n, 5); 0 in
        an absent row."""
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
    """SLOWER in place of a lane change while somebody is nearer along the road than `distance` [m], and whether it took
    its place, (...,)."""
    x, y = scale.offsets(rows)
    along = np.where(rows[..., 1:, 0] > 0, np.abs(x) if scale.relative else np.hypot(x, y), np.inf)
    acts = ((actions == _LEFT) | (actions == _RIGHT)) & (along.min(axis=-1) < distance)
    return np.where(acts, _SLOWER, actions), acts


def somebody_near(rows: NDArray[Any], distance: float, scale: Scale = HIGHWAY) -> BoolArray:
    """Whether anybody is shown nearer to the ego than `distance` [m], (...,)."""
    x, y = scale.offsets(rows)
    apart = np.where(rows[..., 1:, 0] > 0, np.hypot(x, y), np.inf)
    return np.asarray(apart.min(axis=-1) < distance)
