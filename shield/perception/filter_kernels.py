"""The Kalman filters of the tracked vehicles, as compiled loops; `shield.perception.filters` documents them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.state import FloatArray, IntArray
from shield.perception.filters import (
    FAR,
    LEAST,
    ROW_COST,
    ROW_COST_LIMIT,
    Matches,
    Mixtures,
    StateTransition,
    normal_score,
)

__all__ = ["costs", "distances", "measurement_update", "mixture", "predict", "predict_state", "quantiles", "scores"]

_SHARP, _NEAR = 1e-11, 1e-6
"""Accuracy of a quantile, and step size from which the next step suffices for that accuracy, in standard deviations."""
_ROUNDS = 100
_ROOT = math.sqrt(0.5)
_DENSITY = 1.0 / math.sqrt(2.0 * math.pi)


def predict_state(
    means: FloatArray, covariances: FloatArray, transition: StateTransition, pushed: FloatArray, centers: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """See `filters.predict_state`."""
    means, covariances = means.copy(), covariances.copy()
    _move(means, covariances, transition, pushed, centers)
    return means, covariances


def predict(
    chances: FloatArray,
    means: FloatArray,
    covariances: FloatArray,
    changes: FloatArray,
    transition: StateTransition,
    pushed: FloatArray,
    centers: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """See `filters.predict`."""
    after, mixed, spread = np.empty_like(chances), np.empty_like(means), np.empty_like(covariances)
    _begin(chances, means, covariances, changes, after, mixed, spread)
    _move(mixed, spread, transition, pushed, centers)
    return after, mixed, spread


def mixture(chances: FloatArray, means: FloatArray, covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """See `filters.mixture`."""
    n = len(means)
    mean, covariance = np.empty((n, 4)), np.empty((n, 4, 4))
    _mix_all(chances, means, covariances, mean, covariance)
    return mean, covariance


def distances(
    means: FloatArray, covariances: FloatArray, seen: FloatArray, noise: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """See `filters.distances`."""
    n = len(means)
    away, size = np.empty((n, 3, len(seen))), np.empty((n, 3))
    _measure(means, covariances, seen, noise, np.empty((4, 4)), away, size)
    return away, size


def costs(away: FloatArray, places: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """See `filters.costs`."""
    found = np.empty((2, len(places), len(at)))
    _price(away, places, at, found[0], found[1])
    return found[0], found[1]


def measurement_update(
    expected: Mixtures, seen: FloatArray, noise: FloatArray, apart: tuple[FloatArray, FloatArray], pairs: Matches
) -> Mixtures:
    """See `filters.measurement_update`."""
    updated = Mixtures(expected.chances.copy(), expected.means.copy(), expected.covariances.copy())
    _take_in(updated, seen, noise, apart, pairs, np.empty((4, 4, 4)))
    return updated


def quantiles(
    chances: FloatArray, means: FloatArray, covariances: FloatArray, bounds: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """See `filters.quantiles`."""
    found = np.empty((2, len(means), 4))
    _find(chances, means, covariances, bounds, found)
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
    """See `filters.scores`."""
    shares = np.empty((2, len(rows), 4))
    _divide(Mixtures(chances, means, covariances), seen, noise, Matches(rows, columns), shares)
    return normal_score(shares[0], shares[1])


@kernel_inline
def _mix(shares: Any, means: FloatArray, covariances: FloatArray, mean: FloatArray, covariance: FloatArray) -> None:
    """Mean (4,) and covariance (4, 4) of a mixture of three normal distributions, (3, 4) and (3, 4, 4)."""
    for k in range(4):
        mean[k] = shares[0] * means[0, k] + shares[1] * means[1, k] + shares[2] * means[2, k]
    for k in range(4):
        for i in range(k + 1):
            total = 0.0
            for j in range(3):
                apart = (means[j, k] - mean[k]) * (means[j, i] - mean[i])
                total += shares[j] * (covariances[j, k, i] + apart)
            covariance[k, i] = covariance[i, k] = total


@kernel_no_refcount
def _mix_all(
    chances: FloatArray, means: FloatArray, covariances: FloatArray, mean: FloatArray, covariance: FloatArray
) -> None:
    for a in range(len(means)):
        _mix(chances[a], means[a], covariances[a], mean[a], covariance[a])


@kernel_no_refcount
def _begin(
    chances: FloatArray,
    means: FloatArray,
    covariances: FloatArray,
    changes: FloatArray,
    after: FloatArray,
    mixed: FloatArray,
    spread: FloatArray,
) -> None:
    """Predicted model probabilities, and the mixture that each filter starts from."""
    for a in range(len(means)):
        for j in range(3):
            total = 0.0
            for i in range(3):
                total += chances[a, i] * changes[i, j]
            after[a, j] = total
        for j in range(3):
            first = chances[a, 0] * changes[0, j] / after[a, j]
            second = chances[a, 1] * changes[1, j] / after[a, j]
            third = chances[a, 2] * changes[2, j] / after[a, j]
            _mix((first, second, third), means[a], covariances[a], mixed[a, j], spread[a, j])


@kernel_no_refcount
def _move(
    means: FloatArray, covariances: FloatArray, transition: StateTransition, pushed: FloatArray, centers: FloatArray
) -> None:
    for a in range(len(means)):
        for j in range(3):
            mean, p = means[a, j], covariances[a, j]
            y, across = mean[1], p[1, 1]
            mean[0] += transition.reach * mean[2] + transition.along
            mean[1] += transition.dt * mean[3]
            mean[2] = transition.keep * mean[2] + transition.faster
            for i in range(4):
                p[0, i] += transition.reach * p[2, i]
                p[1, i] += transition.dt * p[3, i]
                p[2, i] *= transition.keep
            for i in range(4):
                p[i, 0] += transition.reach * p[i, 2]
                p[i, 1] += transition.dt * p[i, 3]
                p[i, 2] *= transition.keep
            for i in range(4):
                for k in range(4):
                    p[i, k] += pushed[j, i, k]
            if j == 0 and len(centers):
                middle = centers[0]
                for center in centers:
                    if abs(y - center) < abs(y - middle):
                        middle = center
                mean[1], mean[3] = middle + transition.left * (y - middle), 0.0
                for i in range(4):
                    p[1, i] = p[i, 1] = p[3, i] = p[i, 3] = 0.0
                p[1, 1] = transition.left * transition.left * across + transition.stray
                p[3, 3] = transition.sway


@kernel_inline
def _root(p: FloatArray, noise: FloatArray, root: FloatArray) -> None:
    """The lower triangle (4, 4) of which p + noise is the square (Cholesky); the diagonal is inverted."""
    for k in range(4):
        for i in range(k + 1):
            total = p[k, i] + noise[k, i]
            for j in range(i):
                total -= root[k, j] * root[i, j]
            root[k, i] = 1.0 / math.sqrt(total) if k == i else total * root[i, i]


@kernel_no_refcount
def _measure(
    means: FloatArray,
    covariances: FloatArray,
    seen: FloatArray,
    noise: FloatArray,
    root: FloatArray,
    away: FloatArray,
    size: FloatArray,
) -> None:
    for a in range(len(means)):
        for j in range(3):
            _root(covariances[a, j], noise, root)
            size[a, j] = -2.0 * math.log(root[0, 0] * root[1, 1] * root[2, 2] * root[3, 3])
            mean = means[a, j]
            for b in range(len(seen)):
                z0 = (seen[b, 0] - mean[0]) * root[0, 0]
                z1 = (seen[b, 1] - mean[1] - root[1, 0] * z0) * root[1, 1]
                z2 = (seen[b, 2] - mean[2] - root[2, 0] * z0 - root[2, 1] * z1) * root[2, 2]
                z3 = (seen[b, 3] - mean[3] - root[3, 0] * z0 - root[3, 1] * z1 - root[3, 2] * z2) * root[3, 3]
                away[a, j, b] = z0 * z0 + z1 * z1 + z2 * z2 + z3 * z3


@kernel_no_refcount
def _price(away: FloatArray, places: FloatArray, at: FloatArray, least: FloatArray, cost: FloatArray) -> None:
    for a in range(len(places)):
        for b in range(len(at)):
            least[a, b] = min(away[a, 0, b], away[a, 1, b], away[a, 2, b])
            swaps = abs(places[a] - at[b])
            cost[a, b] = min(least[a, b], FAR) + (ROW_COST * min(swaps, ROW_COST_LIMIT) if swaps == swaps else 0.0)


@kernel_inline
def _gains(p: FloatArray, noise: FloatArray, root: FloatArray, gain: FloatArray) -> None:
    """Kalman gain p (p + noise)^-1, (4, 4)."""
    _root(p, noise, root)
    for i in range(4):
        for k in range(4):
            total = p[k, i]
            for j in range(k):
                total -= root[k, j] * gain[i, j]
            gain[i, k] = total * root[k, k]
        for k in range(3, -1, -1):
            total = gain[i, k]
            for j in range(k + 1, 4):
                total -= root[j, k] * gain[i, j]
            gain[i, k] = total * root[k, k]


@kernel_inline
def _around(left: FloatArray, middle: FloatArray, half: FloatArray, found: FloatArray) -> None:
    """left @ middle @ left.T, for a symmetric `middle`."""
    for i in range(4):
        for k in range(4):
            half[i, k] = (
                left[i, 0] * middle[0, k]
                + left[i, 1] * middle[1, k]
                + left[i, 2] * middle[2, k]
                + left[i, 3] * middle[3, k]
            )
    for i in range(4):
        for k in range(i + 1):
            found[i, k] = found[k, i] = (
                half[i, 0] * left[k, 0] + half[i, 1] * left[k, 1] + half[i, 2] * left[k, 2] + half[i, 3] * left[k, 3]
            )


@kernel_no_refcount
def _take_in(
    mixtures: Mixtures,
    seen: FloatArray,
    noise: FloatArray,
    apart: tuple[FloatArray, FloatArray],
    pairs: Matches,
    work: FloatArray,
) -> None:
    """`measurement_update` in place; `work` is a buffer, (4, 4, 4)."""
    chances, means, covariances = mixtures
    (away, size), (rows, columns) = apart, pairs
    root, gain, rest, half = work[0], work[1], work[2], work[3]
    for pair in range(len(rows)):
        a, b = rows[pair], columns[pair]
        best = -math.inf
        for j in range(3):
            log_weight = math.log(chances[a, j]) - 0.5 * (away[a, j, b] + size[a, j])
            chances[a, j] = log_weight
            best = max(best, log_weight)
        total = 0.0
        for j in range(3):
            chances[a, j] = math.exp(chances[a, j] - best) + LEAST
            total += chances[a, j]
        for j in range(3):
            chances[a, j] /= total
            mean, p = means[a, j], covariances[a, j]
            _gains(p, noise, root, gain)
            d0, d1, d2, d3 = seen[b, 0] - mean[0], seen[b, 1] - mean[1], seen[b, 2] - mean[2], seen[b, 3] - mean[3]
            for i in range(4):
                mean[i] += gain[i, 0] * d0 + gain[i, 1] * d1 + gain[i, 2] * d2 + gain[i, 3] * d3
                for k in range(4):
                    rest[i, k] = (1.0 if i == k else 0.0) - gain[i, k]
            _around(rest, p, half, root)
            _around(gain, noise, half, rest)
            for i in range(4):
                for k in range(4):
                    p[i, k] = root[i, k] + rest[i, k]


@kernel_inline
def _tail(z: float) -> float:
    """Probability that a standard normal variable is above z."""
    return 0.5 * math.erfc(z * _ROOT)


@kernel_inline
def _edge(
    chances: FloatArray, m: tuple[float, float, float], s: tuple[float, float, float], bound: float, level: float
) -> float:
    """Value that a mixture of three normal distributions exceeds with probability `level`.

    Parameters
    ----------
    chances, m, s : probabilities, means and standard deviations of the three. level : tail probability of `bound`.
    """
    c0, c1, c2 = chances[0], chances[1], chances[2]
    # A quantile of the mixture lies between the quantiles of its components.
    q0, q1, q2 = m[0] + bound * s[0], m[1] + bound * s[1], m[2] + bound * s[2]
    inside, outside = min(q0, q1, q2), max(q0, q1, q2)
    widest = max(s[0], s[1], s[2])
    edge = c0 * q0 + c1 * q1 + c2 * q2
    # Newton's method for the logarithm of the tail approaches from outside; each iterate stays inside the bracket.
    for _ in range(_ROUNDS):
        if outside - inside <= _SHARP * widest:
            break
        z0, z1, z2 = (edge - m[0]) / s[0], (edge - m[1]) / s[1], (edge - m[2]) / s[2]
        beyond = c0 * _tail(z0) + c1 * _tail(z1) + c2 * _tail(z2)
        slope = _DENSITY * (
            c0 * math.exp(-0.5 * z0 * z0) / s[0]
            + c1 * math.exp(-0.5 * z1 * z1) / s[1]
            + c2 * math.exp(-0.5 * z2 * z2) / s[2]
        )
        step = math.log(beyond / level) * beyond / slope
        if beyond > level:
            inside = edge
        else:
            outside = edge
        edge += step
        if abs(step) <= _NEAR * widest:
            # The remaining error is of the order of the square of the step.
            return min(edge + _SHARP * widest, outside)
        if not inside < edge < outside:
            edge = 0.5 * (inside + outside)
    return outside


@kernel_no_refcount
def _find(
    chances: FloatArray, means: FloatArray, covariances: FloatArray, bounds: FloatArray, found: FloatArray
) -> None:
    for k in range(4):
        below, above = _tail(bounds[0, k]), _tail(bounds[1, k])
        for a in range(len(means)):
            m, p = means[a], covariances[a]
            s = math.sqrt(p[0, k, k]), math.sqrt(p[1, k, k]), math.sqrt(p[2, k, k])
            low = -m[0, k], -m[1, k], -m[2, k]
            found[0, a, k] = -_edge(chances[a], low, s, bounds[0, k], below)
            found[1, a, k] = _edge(chances[a], (m[0, k], m[1, k], m[2, k]), s, bounds[1, k], above)


@kernel_no_refcount
def _divide(mixtures: Mixtures, seen: FloatArray, noise: FloatArray, pairs: Matches, shares: FloatArray) -> None:
    """Probability of an observation further below, and further above, (2, k, 4)."""
    chances, means, covariances = mixtures
    rows, columns = pairs
    for pair in range(len(rows)):
        a, b = rows[pair], columns[pair]
        for k in range(4):
            below = above = 0.0
            for j in range(3):
                z = (seen[b, k] - means[a, j, k]) / math.sqrt(covariances[a, j, k, k] + noise[k, k])
                below += chances[a, j] * _tail(-z)
                above += chances[a, j] * _tail(z)
            shares[0, pair, k], shares[1, pair, k] = below, above
