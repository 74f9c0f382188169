"""The Kalman filters of those who are followed, as formulas. `filter_kernels` has the same as compiled loops.

Notation
--------
n vehicles are followed, by three filters each, and m are seen. Of each filter: `means` (n, 3, 4) and `covariances`
(n, 3, 4, 4) of x, y [m], vx, vy [m/s], and `chances` (n, 3), how likely each is the one that holds (an interacting
multiple model, Blom and Bar-Shalom 1988). `noise` (4, 4) is the covariance of what is seen.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from dynamics.state import FloatArray, IntArray

__all__ = [
    "FAR",
    "FARTHEST",
    "LEAST",
    "SWAP",
    "SWAPS",
    "Course",
    "costs",
    "distances",
    "expected",
    "mixture",
    "moved",
    "quantiles",
    "scores",
    "side",
    "taken_in",
]

LEAST = 1e-12
"""What is so unlikely that it is 0 would never come back."""
FARTHEST = 8.0
"""Nobody is further from where it is expected than so many standard deviations, as far as bounds and scores go."""
FAR = 1e6
"""What it costs to be matched beyond every gate."""
SWAP, SWAPS = 2.0, 3.0
"""What it costs, as a squared distance, to be a row further up or down than before, and for how many rows at most:
rows that are sorted by what is there say who is who, where what they show says little."""
_HALVINGS = 48


class Course(NamedTuple):
    """What becomes of a state within a time step, but for what cannot be foreseen.

    Attributes
    ----------
    dt : the step [s].
    keep : share of a difference from the usual speed that is left. reach : for how long the speed of before lasts [s].
    along, faster : what the usual speed adds to x [m], and to vx [m/s].
    left : share of a distance from the middle of the lane that is left. stray, sway : variances across, of the place
        [m^2] and of the velocity [m^2/s^2], of one that keeps to its lane.
    """

    dt: float
    keep: float
    reach: float
    along: float
    faster: float
    left: float
    stray: float
    sway: float


def moved(
    means: FloatArray, covariances: FloatArray, course: Course, pushed: FloatArray, centers: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Means and covariances a step later.

    Parameters
    ----------
    pushed : what the accelerations of each filter add to its covariance, (3, 4, 4).
    centers : of the lanes, along y, (lanes,) [m]: the first filter is drawn to the nearest; without any, it is not.
    """
    step = np.diag([1.0, 1.0, course.keep, 1.0])
    step[0, 2], step[1, 3] = course.reach, course.dt
    after, spread = means @ step.T, step @ covariances @ step.T + pushed
    after[..., 0] += course.along
    after[..., 2] += course.faster
    if centers.size and len(means):
        y = means[:, 0, 1]
        middle = centers[np.abs(y[:, None] - centers).argmin(axis=1)]
        after[:, 0, 1], after[:, 0, 3] = middle + course.left * (y - middle), 0.0
        spread[:, 0, [1, 3], :] = spread[:, 0, :, [1, 3]] = 0.0
        spread[:, 0, 1, 1] = course.left**2 * covariances[:, 0, 1, 1] + course.stray
        spread[:, 0, 3, 3] = course.sway
    return after, spread


def expected(
    chances: FloatArray,
    means: FloatArray,
    covariances: FloatArray,
    changes: FloatArray,
    course: Course,
    pushed: FloatArray,
    centers: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Chances, means and covariances a step later, before anything more is seen.

    Parameters
    ----------
    changes : probability of one filter holding and, a step later, another, (3, 3).
    """
    after = chances @ changes
    # Each filter begins from all, as likely as each has led there.
    led = np.swapaxes(chances[:, :, None] * changes / after[:, None, :], 1, 2)
    begun = [mixture(led[:, j], means, covariances) for j in range(chances.shape[1])]
    mixed, spread = (np.stack(each, axis=1) for each in zip(*begun, strict=True))
    return after, *moved(mixed, spread, course, pushed, centers)


def mixture(chances: FloatArray, means: FloatArray, covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (n, 4) and covariance (n, 4, 4) of all filters together."""
    mean = np.einsum("nj,nji->ni", chances, means)
    apart = means - mean[:, None]
    return mean, np.einsum("nj,njik->nik", chances, covariances + apart[..., :, None] * apart[..., None, :])


def distances(
    means: FloatArray, covariances: FloatArray, seen: FloatArray, noise: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Squared Mahalanobis distance of each who is seen from where each filter expects it, (n, 3, m), and the logarithm
    of the determinant of the covariance that it is measured by, (n, 3).

    Parameters
    ----------
    seen : states, (m, 4).
    """
    spread = covariances + noise
    apart = seen[None, None] - means[:, :, None]
    away = np.einsum("njmk,njkm->njm", apart, np.linalg.solve(spread, np.swapaxes(apart, 2, 3)))
    return away, np.linalg.slogdet(spread)[1]


def costs(away: FloatArray, places: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The least of the squared distances of three filters, (n, m), and what it costs to take the one for the other,
    (n, m).

    Parameters
    ----------
    away : as of `distances`. places, at : rows of those who are followed, when they were seen last, (n,), and of those
        who are seen, (m,); NaN where rows say nothing.
    """
    least = away.min(axis=1, initial=np.inf)
    swaps = np.nan_to_num(np.minimum(np.abs(places[:, None] - at), SWAPS))
    return least, np.minimum(least, FAR) + SWAP * swaps


def taken_in(
    chances: FloatArray,
    means: FloatArray,
    covariances: FloatArray,
    seen: FloatArray,
    noise: FloatArray,
    away: FloatArray,
    size: FloatArray,
    rows: IntArray,
    columns: IntArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Chances, means and covariances after the k vehicles `rows` (k,) have been seen as `columns` (k,) of `seen`; those
    of all others stay. Joseph's form, which stays symmetric and positive.

    Parameters
    ----------
    away, size : as of `distances`.
    """
    chances, means, covariances = chances.copy(), means.copy(), covariances.copy()
    likely = np.log(chances[rows]) - 0.5 * (away[rows, :, columns] + size[rows])
    likely = np.exp(likely - likely.max(axis=1, keepdims=True, initial=-np.inf)) + LEAST
    chances[rows] = likely / likely.sum(axis=1, keepdims=True)
    before = covariances[rows]
    gain = np.swapaxes(np.linalg.solve(before + noise, before), -1, -2)
    rest = np.eye(4) - gain
    means[rows] += np.einsum("njik,njk->nji", gain, seen[columns][:, None] - means[rows])
    covariances[rows] = rest @ before @ np.swapaxes(rest, -1, -2) + gain @ noise @ np.swapaxes(gain, -1, -2)
    return chances, means, covariances


def quantiles(
    chances: FloatArray, means: FloatArray, covariances: FloatArray, bounds: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Between what each of x, y, vx and vy is, (n, 4) and (n, 4): so likely to be less, or more, as a normal
    distribution is to be further than so many standard deviations to one side.

    Parameters
    ----------
    bounds : below and above, of each, (2, 4).
    """
    spread = np.sqrt(np.einsum("njii->nji", covariances))
    found = []
    for sign, bound in zip((-1.0, 1.0), bounds, strict=True):
        # A quantile of the mixture is between those of its parts.
        each = sign * means + bound * spread
        inside, outside = each.min(axis=1), each.max(axis=1)
        for _ in range(_HALVINGS):
            middle = 0.5 * (inside + outside)
            beyond = (chances[:, :, None] * ndtr((sign * means - middle[:, None]) / spread)).sum(axis=1)
            exceeded = beyond > ndtr(-bound)
            inside, outside = np.where(exceeded, middle, inside), np.where(exceeded, outside, middle)
        found.append(sign * outside)
    return found[0], found[1]


def scores(
    chances: FloatArray,
    means: FloatArray,
    covariances: FloatArray,
    seen: FloatArray,
    noise: FloatArray,
    rows: IntArray,
    columns: IntArray,
) -> FloatArray:
    """How far k vehicles, `rows` (k,), are from where they were expected, seen as `columns` (k,) of `seen`: (k, 4), in
    standard deviations of a normal distribution that is as likely to be exceeded, from -`FARTHEST` to `FARTHEST`.

    A score is above b where, and only where, what is seen is beyond the quantile of what was expected to be seen that
    belongs to the bound b.
    """
    spread = np.sqrt(np.einsum("njii->nji", covariances[rows]) + np.diag(noise))
    apart, chosen = (seen[columns][:, None] - means[rows]) / spread, chances[rows][:, :, None]
    return side((chosen * ndtr(apart)).sum(axis=1), (chosen * ndtr(-apart)).sum(axis=1))


def side(below: FloatArray, above: FloatArray) -> FloatArray:
    """Where a normal distribution has so much `below` it, and so much `above`, in standard deviations; the smaller is
    the exact one."""
    where: FloatArray = np.where(below < above, ndtri(np.minimum(below, 0.5)), -ndtri(np.minimum(above, 0.5)))
    return np.clip(where, -FARTHEST, FARTHEST)
