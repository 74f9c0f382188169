"""Who is who from one observation to the next, and what each is doing: assignment, and three Kalman filters for each.

Notation
--------
State of a vehicle: x [m], y [m], vx, vy [m/s] in the world's directions. Lanes lie along x. From one observation to the
next a vehicle does one of three things, which change at random:

- *calm*, it drives on: along x it keeps its velocity, but for an acceleration that is white noise, and across it is
  drawn to the middle of the nearest lane;
- *free*, it does not keep to a lane: across, too, it keeps its velocity but for white noise;
- *brisk*: both accelerations are large. In frames of 0.2 s highway-env's cars swing to and fro by 1 m as they change
  lanes.

So each vehicle has an estimate for each, and the probability of each (the interacting multiple model of Blom and
Bar-Shalom 1988); mean and covariance are those of the mixture. Which row of an observation is whom is the assignment of
least total Mahalanobis distance, with those further apart than a gate left over: they are new, or out of sight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.optimize import linear_sum_assignment

from dynamics.state import FloatArray, IntArray

__all__ = ["Motions", "Tracks", "ahead_of", "follow"]

_GATE = 36.0
"""Squared Mahalanobis distance beyond which two are not the same: chi^2 with 4 degrees exceeds it once in 4 million."""
_FAR = 1e6
"""What it costs to be matched beyond the gate."""
_SETTLING, _WAVER = 1.0, 0.15
"""One that keeps to its lane is drawn to its middle within this [s], and strays from it by this [m]."""
_RATES = np.array([[-0.2, 0.1, 0.1], [0.5, -0.6, 0.1], [0.5, 0.5, -1.0]])
"""How often one that does this does that instead [1/s]."""
_MODES = 3


class Motions(NamedTuple):
    """How vehicles move.

    Attributes
    ----------
    calm, free, brisk : standard deviations of the accelerations along x and y [m/s^2].
    centers : of the lanes, along y, (lanes,) [m]; without any, a calm one keeps its velocity across as well.
    """

    calm: tuple[float, float] = (2.0, 1.0)
    free: tuple[float, float] = (2.0, 3.0)
    brisk: tuple[float, float] = (8.0, 40.0)
    centers: FloatArray | None = None


def _none(*shape: int) -> FloatArray:
    return np.zeros((0, *shape))


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """n vehicles that are followed.

    Attributes
    ----------
    ids : which is which, (n,); never given twice.
    means, covariances : of each estimate, calm, free and brisk, (n, 3, 4) and (n, 3, 4, 4). chances : of each, (n, 3).
    missed : for how many observations in a row each has not been seen, (n,).
    next_id : of the next newcomer.
    innovation : squared Mahalanobis distance between what was expected of each and what was seen, the least of the
        three, (n,); NaN of who has just come or was not seen.
    """

    ids: IntArray = field(default_factory=lambda: np.zeros(0, np.intp))
    means: FloatArray = field(default_factory=lambda: _none(_MODES, 4))
    covariances: FloatArray = field(default_factory=lambda: _none(_MODES, 4, 4))
    chances: FloatArray = field(default_factory=lambda: _none(_MODES))
    missed: IntArray = field(default_factory=lambda: np.zeros(0, np.intp))
    next_id: int = 1
    innovation: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def mean(self) -> FloatArray:
        """Of all estimates together, (n, 4)."""
        return np.einsum("nj,nji->ni", self.chances, self.means)

    @property
    def covariance(self) -> FloatArray:
        """Of all together, (n, 4, 4)."""
        return _mixed(self.chances, self.means, self.covariances, self.mean)


def follow(
    tracks: Tracks, seen: FloatArray, noise: FloatArray, dt: float, motions: Motions, patience: int = 0
) -> Tracks:
    """The tracks after one more observation.

    Parameters
    ----------
    tracks : before it. seen : states of those seen, (m, 4), in any order.
    noise : covariance of one of these, (4, 4). dt : time since the observation before [s].
    patience : for how many observations in a row somebody may be missing.
    """
    chances, means, covariances = _predict(tracks, dt, motions)
    spread = covariances + noise
    apart = seen[None, None] - means[:, :, None]
    away = np.einsum("njmk,njkm->njm", apart, np.linalg.solve(spread, np.swapaxes(apart, 2, 3)))
    least = away.min(axis=1, initial=np.inf) if len(means) else np.zeros((0, len(seen)))
    rows, columns = linear_sum_assignment(np.minimum(least, _FAR))
    matched = least[rows, columns] <= _GATE
    rows, columns = rows[matched], columns[matched]
    innovation = np.full(len(means), np.nan)
    innovation[rows] = least[rows, columns]
    # What is so unlikely that it is 0 would never come back.
    size = np.linalg.slogdet(spread[rows])[1]
    likely = np.log(chances[rows]) - 0.5 * (away[rows, :, columns] + size)
    likely = np.exp(likely - likely.max(axis=1, keepdims=True, initial=-np.inf)) + 1e-12
    chances[rows] = likely / likely.sum(axis=1, keepdims=True)
    means[rows], covariances[rows] = _update(means[rows], covariances[rows], seen[columns], noise)
    missed = tracks.missed + 1
    missed[rows] = 0
    kept = missed <= patience
    new = np.setdiff1d(np.arange(len(seen)), columns)
    n = len(new)
    return Tracks(
        np.concatenate([tracks.ids[kept], tracks.next_id + np.arange(n)]),
        np.concatenate([means[kept], np.repeat(seen[new, None], _MODES, axis=1)]),
        np.concatenate([covariances[kept], np.broadcast_to(noise, (n, _MODES, 4, 4))]),
        np.concatenate([chances[kept], np.full((n, _MODES), 1 / _MODES)]),
        np.concatenate([missed[kept], np.zeros(n, np.intp)]),
        tracks.next_id + n,
        np.concatenate([innovation[kept], np.full(n, np.nan)]),
    )


def ahead_of(tracks: Tracks, late: float, motions: Motions) -> Tracks:
    """Where those who are followed are `late` [s] after they were seen, with nothing seen since: calm ones go on as
    such, and all others as free ones (nobody swings for so long)."""
    if not late or not len(tracks.ids):
        return tracks
    modes = motions.calm, motions.free, motions.free
    means, covariances = _moved(tracks.means, tracks.covariances, late, modes, motions.centers)
    return replace(tracks, means=means, covariances=covariances)


def _predict(tracks: Tracks, dt: float, motions: Motions) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Chances, means and covariances of each estimate before anything more is seen."""
    changes = _changes(dt)
    chances = tracks.chances @ changes
    # Each estimate begins from all, as likely as each has led there.
    led = np.swapaxes(tracks.chances[:, :, None] * changes / chances[:, None, :], 1, 2)
    means = np.einsum("nji,nik->njk", led, tracks.means)
    begun = np.stack([_mixed(led[:, j], tracks.means, tracks.covariances, means[:, j]) for j in range(_MODES)], axis=1)
    modes = motions.calm, motions.free, motions.brisk
    return chances, *_moved(means, begun, dt, modes, motions.centers)


def _moved(
    means: FloatArray,
    covariances: FloatArray,
    dt: float,
    modes: tuple[tuple[float, float], ...],
    centers: FloatArray | None,
) -> tuple[FloatArray, FloatArray]:
    """Estimates `dt` later, each with the accelerations of its mode; the first keeps to the lanes at `centers`."""
    step = np.eye(4)
    step[0, 2] = step[1, 3] = dt
    after, spread = means @ step.T, step @ covariances @ step.T
    for j, accelerations in enumerate(modes):
        spread[:, j] += _pushed(dt, accelerations)
    if centers is not None and len(means):
        _keep_lane(means[:, 0, 1], covariances[:, 0, 1, 1], dt, centers, after[:, 0], spread[:, 0])
    return after, spread


@lru_cache(maxsize=16)
def _changes(dt: float) -> FloatArray:
    """Probabilities of doing this and, `dt` later, that, (3, 3)."""
    changes: FloatArray = expm(_RATES * dt)
    return changes


def _mixed(chances: FloatArray, means: FloatArray, covariances: FloatArray, mean: FloatArray) -> FloatArray:
    """Covariance (n, 4, 4) of a mixture, with its `mean`."""
    apart = means - mean[:, None]
    return np.einsum("nj,njik->nik", chances, covariances + apart[..., :, None] * apart[..., None, :])


def _pushed(dt: float, accelerations: tuple[float, float]) -> FloatArray:
    """What white accelerations of a frame add to a covariance."""
    pushed = np.zeros((4, 4))
    for axis, a in enumerate(accelerations):
        g = np.zeros(4)
        g[axis], g[axis + 2] = dt * dt / 2, dt
        pushed += a * a * np.outer(g, g)
        # highway-env moves by the speed of before, another half of it.
        pushed[axis, axis] += (a * dt * dt / 4) ** 2
    return pushed


def _keep_lane(
    y: FloatArray, spread: FloatArray, dt: float, centers: FloatArray, mean: FloatArray, covariance: FloatArray
) -> None:
    """Have what is expected across of those at `y` (n,), with variance `spread`, be drawn to the middle of their
    lanes: fills in y and vy of `mean` (n, 4) and `covariance` (n, 4, 4)."""
    left = math.exp(-dt / _SETTLING)
    middle = centers[np.abs(y[:, None] - centers).argmin(axis=1)]
    mean[:, 1], mean[:, 3] = middle + left * (y - middle), 0.0
    covariance[:, [1, 3], :] = covariance[:, :, [1, 3]] = 0.0
    covariance[:, 1, 1] = left**2 * spread + (1 - left**2) * _WAVER**2
    covariance[:, 3, 3] = (_WAVER / _SETTLING) ** 2 + 1e-2


def _update(
    means: FloatArray, covariances: FloatArray, seen: FloatArray, noise: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Joseph's form, which stays symmetric and positive."""
    gain = np.swapaxes(np.linalg.solve(covariances + noise, covariances), -1, -2)
    rest = np.eye(4) - gain
    updated = means + np.einsum("njik,njk->nji", gain, seen[:, None] - means)
    return updated, rest @ covariances @ np.swapaxes(rest, -1, -2) + gain @ noise @ np.swapaxes(gain, -1, -2)
