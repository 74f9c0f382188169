"""The Kalman filters of the tracked vehicles, as numpy formulas. `filter_kernels` has the same as compiled loops.

Notation
--------
n vehicles are tracked with three filters each, and m vehicles are observed. Each filter has `means` (n, 3, 4) and
`covariances` (n, 3, 4, 4) of x, y [m], vx, vy [m/s], and `chances` (n, 3), the probability of its motion model.
Together they are an interacting multiple model (Blom and Bar-Shalom 1988). `noise` (4, 4) is the covariance of an
observation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from dynamics.state import FloatArray, IntArray

__all__ = [
    "FAR",
    "LEAST",
    "ROW_COST",
    "ROW_COST_LIMIT",
    "SCORE_LIMIT",
    "Matches",
    "Mixtures",
    "StateTransition",
    "costs",
    "distances",
    "measurement_update",
    "mixture",
    "normal_score",
    "predict",
    "predict_state",
    "quantiles",
    "scores",
]

LEAST = 1e-12
"""Least probability of a model. A probability of 0 could not increase again."""
SCORE_LIMIT = 8.0
"""Greatest bound and greatest score, in standard deviations."""
FAR = 1e6
"""Cost of a match beyond every gate."""
ROW_COST, ROW_COST_LIMIT = 2.0, 3.0
"""Cost of a match for each row of difference between two observations, as a squared distance, and the rows that count
at most. Sorted rows identify a vehicle where its state alone does not."""
_HALVINGS = 48


class StateTransition(NamedTuple):
    """Deterministic part of a state transition within a time step.

    Attributes
    ----------
    dt : the step [s].
    keep : factor on the difference from the usual speed. reach : effective duration of the previous speed [s].
    along, faster : contribution of the usual speed to x [m] and to vx [m/s].
    left : factor on the distance from the centre of the lane.
    stray, sway : variances across the road of a vehicle that keeps its lane, of y [m^2] and vy [m^2/s^2].
    """

    dt: float
    keep: float
    reach: float
    along: float
    faster: float
    left: float
    stray: float
    sway: float


class Mixtures(NamedTuple):
    """State of the filters: `chances` (n, 3), `means` (n, 3, 4) and `covariances` (n, 3, 4, 4)."""

    chances: FloatArray
    means: FloatArray
    covariances: FloatArray


class Matches(NamedTuple):
    """Vehicles `rows` (k,) were observed as vehicles `columns` (k,)."""

    rows: IntArray
    columns: IntArray


def predict_state(
    means: FloatArray, covariances: FloatArray, transition: StateTransition, pushed: FloatArray, centers: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Means and covariances one step later.

    Parameters
    ----------
    pushed : process noise of each filter, from its accelerations, (3, 4, 4).
    centers : lane centres along y, (lanes,) [m]. The first filter is drawn to the nearest; without centres it is not.
    """
    step = np.diag([1.0, 1.0, transition.keep, 1.0])
    step[0, 2], step[1, 3] = transition.reach, transition.dt
    after, spread = means @ step.T, step @ covariances @ step.T + pushed
    after[..., 0] += transition.along
    after[..., 2] += transition.faster
    if centers.size and len(means):
        y = means[:, 0, 1]
        middle = centers[np.abs(y[:, None] - centers).argmin(axis=1)]
        after[:, 0, 1], after[:, 0, 3] = middle + transition.left * (y - middle), 0.0
        spread[:, 0, [1, 3], :] = spread[:, 0, :, [1, 3]] = 0.0
        spread[:, 0, 1, 1] = transition.left**2 * covariances[:, 0, 1, 1] + transition.stray
        spread[:, 0, 3, 3] = transition.sway
    return after, spread


def predict(
    chances: FloatArray,
    means: FloatArray,
    covariances: FloatArray,
    changes: FloatArray,
    transition: StateTransition,
    pushed: FloatArray,
    centers: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Predicted probabilities, means and covariances one step later.

    Parameters
    ----------
    changes : probability of a transition from one model (row) to another (column) within the step, (3, 3).
    """
    after = chances @ changes
    # Interaction: each filter starts from the mixture of all, weighted by the transition probabilities.
    led = np.swapaxes(chances[:, :, None] * changes / after[:, None, :], 1, 2)
    begun = [mixture(led[:, j], means, covariances) for j in range(chances.shape[1])]
    mixed, spread = (np.stack(each, axis=1) for each in zip(*begun, strict=True))
    return after, *predict_state(mixed, spread, transition, pushed, centers)


def mixture(chances: FloatArray, means: FloatArray, covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (n, 4) and covariance (n, 4, 4) of the mixture of all filters."""
    mean = np.einsum("nj,nji->ni", chances, means)
    apart = means - mean[:, None]
    return mean, np.einsum("nj,njik->nik", chances, covariances + apart[..., :, None] * apart[..., None, :])


def distances(
    means: FloatArray, covariances: FloatArray, seen: FloatArray, noise: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Squared Mahalanobis distance of each observed vehicle from each filter's prediction, (n, 3, m), and
    log-determinant of the innovation covariance, (n, 3).

    Parameters
    ----------
    seen : observed states, (m, 4).
    """
    spread = covariances + noise
    apart = seen[None, None] - means[:, :, None]
    away = np.einsum("njmk,njkm->njm", apart, np.linalg.solve(spread, np.swapaxes(apart, 2, 3)))
    return away, np.linalg.slogdet(spread)[1]


def costs(away: FloatArray, places: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least squared distance over the three filters, (n, m), and assignment cost of each pair, (n, m).

    Parameters
    ----------
    away : see `distances`.
    places, at : row of each tracked vehicle when it was last seen, (n,), and of each observed one, (m,). NaN where rows
        carry no information.
    """
    least = away.min(axis=1, initial=np.inf)
    swaps = np.nan_to_num(np.minimum(np.abs(places[:, None] - at), ROW_COST_LIMIT))
    return least, np.minimum(least, FAR) + ROW_COST * swaps


def measurement_update(
    expected: Mixtures, seen: FloatArray, noise: FloatArray, apart: tuple[FloatArray, FloatArray], pairs: Matches
) -> Mixtures:
    """State of the filters after the measurement update, in Joseph's form, which stays symmetric and positive. Vehicles
    that were not observed keep their values.

    Parameters
    ----------
    expected : prediction. seen : observed states, (m, 4). apart : of `distances`.
    """
    chances, means, covariances = (each.copy() for each in expected)
    (away, size), (rows, columns) = apart, pairs
    weights = np.log(chances[rows]) - 0.5 * (away[rows, :, columns] + size[rows])
    weights = np.exp(weights - weights.max(axis=1, keepdims=True, initial=-np.inf)) + LEAST
    chances[rows] = weights / weights.sum(axis=1, keepdims=True)
    before = covariances[rows]
    gain = np.swapaxes(np.linalg.solve(before + noise, before), -1, -2)
    rest = np.eye(4) - gain
    means[rows] += np.einsum("njik,njk->nji", gain, seen[columns][:, None] - means[rows])
    covariances[rows] = rest @ before @ np.swapaxes(rest, -1, -2) + gain @ noise @ np.swapaxes(gain, -1, -2)
    return Mixtures(chances, means, covariances)


def quantiles(
    chances: FloatArray, means: FloatArray, covariances: FloatArray, bounds: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Lower and upper bounds of x, y, vx and vy, (n, 4) and (n, 4).

    The mixture exceeds each bound with the probability that a normal distribution exceeds the given number of standard
    deviations.

    Parameters
    ----------
    bounds : standard deviations below and above, for each component, (2, 4).
    """
    spread = np.sqrt(np.einsum("njii->nji", covariances))
    found = []
    for sign, bound in zip((-1.0, 1.0), bounds, strict=True):
        # A quantile of the mixture lies between the quantiles of its components.
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
    """Innovations of k vehicles as normal scores, (k, 4), from -`SCORE_LIMIT` to `SCORE_LIMIT`.

    Vehicles `rows` (k,) were observed as `columns` (k,) of `seen`. A score is above b if and only if the observation is
    beyond the quantile of the predicted observation that belongs to the bound b.
    """
    spread = np.sqrt(np.einsum("njii->nji", covariances[rows]) + np.diag(noise))
    apart, chosen = (seen[columns][:, None] - means[rows]) / spread, chances[rows][:, :, None]
    return normal_score((chosen * ndtr(apart)).sum(axis=1), (chosen * ndtr(-apart)).sum(axis=1))


def normal_score(below: FloatArray, above: FloatArray) -> FloatArray:
    """Normal score with probability `below` below it and `above` above it; the smaller probability is the exact one."""
    where: FloatArray = np.where(below < above, ndtri(np.minimum(below, 0.5)), -ndtri(np.minimum(above, 0.5)))
    return np.clip(where, -SCORE_LIMIT, SCORE_LIMIT)
