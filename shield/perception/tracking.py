"""Who is who from one observation to the next, and what each is doing: assignment, and a Kalman filter for each.

Notation
--------
State of a vehicle: x [m], y [m], vx, vy [m/s] in the world's directions, with mean (n, 4) and covariance (n, 4, 4).
Between two observations everybody keeps its velocity, but for an acceleration that is white noise:

    x' = x + vx dt        P' = F P F^T + G diag(a_x^2, a_y^2) G^T        G = (dt^2 / 2, dt)

Which row of an observation is whom is the assignment of least total Mahalanobis distance (Bar-Shalom and Li 1995),
with those further apart than a gate left over: they are new, or out of sight.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment

from dynamics.state import BoolArray, FloatArray, IntArray

__all__ = ["Tracks", "follow"]

_GATE = 36.0
"""Squared Mahalanobis distance beyond which two are not the same: chi^2 with 4 degrees exceeds it once in 4 million."""
_FAR = 1e6
"""What it costs to be matched beyond the gate."""


def _none(*shape: int) -> FloatArray:
    return np.zeros((0, *shape))


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """n vehicles that are followed.

    Attributes
    ----------
    ids : which is which, (n,); never given twice. mean, covariance : (n, 4) and (n, 4, 4).
    missed : for how many observations in a row each has not been seen, (n,).
    next_id : of the next newcomer.
    innovation : squared Mahalanobis distance between what was expected of each and what was seen, (n,); NaN of who has
        just come or was not seen.
    """

    ids: IntArray = field(default_factory=lambda: np.zeros(0, np.intp))
    mean: FloatArray = field(default_factory=lambda: _none(4))
    covariance: FloatArray = field(default_factory=lambda: _none(4, 4))
    missed: IntArray = field(default_factory=lambda: np.zeros(0, np.intp))
    next_id: int = 1
    innovation: FloatArray = field(default_factory=lambda: np.zeros(0))


def follow(
    tracks: Tracks,
    seen: FloatArray,
    noise: FloatArray,
    dt: float,
    accelerations: tuple[float, float],
    patience: int = 0,
) -> Tracks:
    """The tracks after one more observation.

    Parameters
    ----------
    tracks : before it. seen : states of those seen, (m, 4), in any order.
    noise : covariance of one of these, (4, 4). dt : time since the observation before [s].
    accelerations : standard deviations along x and y [m/s^2].
    patience : for how many observations in a row somebody may be missing.
    """
    mean, covariance = _predict(tracks.mean, tracks.covariance, dt, accelerations)
    apart = _distances(mean, covariance + noise, seen)
    rows, columns = linear_sum_assignment(np.minimum(apart, _FAR))
    matched = apart[rows, columns] <= _GATE
    rows, columns = rows[matched], columns[matched]
    innovation = np.full(len(mean), np.nan)
    innovation[rows] = apart[rows, columns]
    mean[rows], covariance[rows] = _update(mean[rows], covariance[rows], seen[columns], noise)
    missed = tracks.missed + 1
    missed[rows] = 0
    kept: BoolArray = missed <= patience
    new = np.setdiff1d(np.arange(len(seen)), columns)
    n = len(new)
    return Tracks(
        np.concatenate([tracks.ids[kept], tracks.next_id + np.arange(n)]),
        np.concatenate([mean[kept], seen[new]]),
        np.concatenate([covariance[kept], np.broadcast_to(noise, (n, 4, 4))]),
        np.concatenate([missed[kept], np.zeros(n, np.intp)]),
        tracks.next_id + n,
        np.concatenate([innovation[kept], np.full(n, np.nan)]),
    )


def _predict(
    mean: FloatArray, covariance: FloatArray, dt: float, accelerations: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    step = np.eye(4)
    step[0, 2] = step[1, 3] = dt
    pushed = np.zeros((4, 4))
    for axis, a in enumerate(accelerations):
        g = np.zeros(4)
        g[axis], g[axis + 2] = dt * dt / 2, dt
        pushed += a * a * np.outer(g, g)
        # Nobody's mean acceleration of a frame moves it to the last digit.
        pushed[axis, axis] += (a * dt * dt / 4) ** 2
    return mean @ step.T, step @ covariance @ step.T + pushed


def _distances(mean: FloatArray, spread: FloatArray, seen: FloatArray) -> FloatArray:
    """Squared Mahalanobis distances, (n, m)."""
    apart = seen[None] - mean[:, None]
    solved = np.linalg.solve(spread, np.swapaxes(apart, 1, 2))
    return np.einsum("nmk,nkm->nm", apart, solved)


def _update(
    mean: FloatArray, covariance: FloatArray, seen: FloatArray, noise: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Joseph's form, which stays symmetric and positive."""
    gain = np.swapaxes(np.linalg.solve(covariance + noise, covariance), 1, 2)
    rest = np.eye(4) - gain
    updated = mean + np.einsum("nij,nj->ni", gain, seen - mean)
    return updated, rest @ covariance @ np.swapaxes(rest, 1, 2) + gain @ noise @ np.swapaxes(gain, 1, 2)
