"""Intervals and paired tests for episode results.

Every function takes plain arrays and returns a frozen record with the number of samples. Resampling uses a fixed seed,
so the same episodes give the same table.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from shield.errors import ConfigError

__all__ = [
    "CONFIDENCE",
    "Interval",
    "McNemar",
    "bootstrap_mean",
    "clopper_pearson",
    "interquartile_mean",
    "mcnemar",
    "nested_bootstrap",
    "paired_difference",
    "paired_rate_difference",
    "quantiles",
    "wilson",
]

CONFIDENCE = 0.95
"""Default coverage of every interval."""

_RESAMPLES = 9999
_SEED = 0
_BATCH_CELLS = 4_000_000
_NESTED_RESAMPLES = 999


@dataclass(frozen=True, slots=True)
class Interval:
    """An estimate and its confidence interval, in the unit of the samples.

    Attributes
    ----------
    estimate : the rate or mean.
    low, high : ends of the interval; NaN if a single sample admits none.
    n : number of samples (pairs, for a paired difference).
    """

    estimate: float
    low: float
    high: float
    n: int


@dataclass(frozen=True, slots=True)
class McNemar:
    """Exact McNemar test of two paired binary outcomes.

    Attributes
    ----------
    only_first, only_second : number of discordant pairs with the event in the first, or in the second outcome.
    p_value : two-sided, exact binomial on the discordant pairs; 1 without any.
    n : number of pairs.
    """

    only_first: int
    only_second: int
    p_value: float
    n: int


def clopper_pearson(count: int, n: int, confidence: float = CONFIDENCE) -> Interval:
    """The exact two-sided interval of a rate (Clopper and Pearson 1934), for claims about rates near 0.

    With a count of 0 its upper end is that of the one-sided interval of the same confidence, 1 - (1 - c)^(1/n).

    Examples
    --------
    >>> round(clopper_pearson(0, 1000).high, 5)
    0.00299
    """
    if not 0 <= count <= n or n < 1:
        raise ConfigError(f"a rate needs 0 <= count <= n and n >= 1, got {count} of {n}")
    alpha = 1.0 - confidence
    tail = alpha if count == 0 else alpha / 2
    low = 0.0 if count == 0 else float(stats.beta.ppf(alpha / 2, count, n - count + 1))
    high = 1.0 if count == n else float(stats.beta.ppf(1.0 - tail, count + 1, n - count))
    return Interval(count / n, low, high, n)


def wilson(successes: int, n: int, confidence: float = CONFIDENCE) -> Interval:
    """Wilson score interval of a rate.

    Examples
    --------
    >>> interval = wilson(0, 1000)
    >>> interval.estimate, round(interval.high, 4)
    (0.0, 0.0038)
    """
    if n < 1 or not 0 <= successes <= n:
        raise ConfigError(f"a rate needs 0 <= successes <= n and n >= 1, got {successes} of {n}")
    result = stats.binomtest(int(successes), int(n))
    bounds = result.proportion_ci(confidence_level=confidence, method="wilson")
    return Interval(successes / n, float(bounds.low), float(bounds.high), int(n))


def bootstrap_mean(values: ArrayLike, confidence: float = CONFIDENCE) -> Interval:
    """Mean with a percentile bootstrap interval.

    Equal samples give an interval of width 0; a single sample gives NaN. The bias-corrected interval is not used,
    because it is undefined for some samples.
    """
    samples = _samples(values)
    mean, n = float(samples.mean()), int(samples.size)
    if n == 1:
        return Interval(mean, float("nan"), float("nan"), n)
    if np.ptp(samples) == 0.0:
        return Interval(mean, mean, mean, n)
    result = stats.bootstrap(
        (samples,),
        np.mean,
        confidence_level=confidence,
        n_resamples=_RESAMPLES,
        batch=max(1, _BATCH_CELLS // n),
        method="percentile",
        rng=np.random.default_rng(_SEED),
    )
    bounds = result.confidence_interval
    return Interval(mean, float(bounds.low), float(bounds.high), n)


def interquartile_mean(values: ArrayLike) -> float:
    """Mean of the middle half of the samples.

    Examples
    --------
    >>> interquartile_mean([0.0, 1.0, 3.0, 100.0])
    2.0
    """
    return float(stats.trim_mean(_samples(values), 0.25))


def nested_bootstrap(
    groups: Sequence[ArrayLike],
    statistic: Callable[[NDArray[np.float64]], Any] = np.mean,
    confidence: float = CONFIDENCE,
) -> Interval:
    """A statistic of all samples, with a percentile bootstrap interval over groups and over the samples in each.

    Groups are training seeds, and samples are their episodes. Each resample draws groups, and samples within each, with
    replacement. Episodes of the same model are correlated. So an interval over pooled episodes would be too narrow for
    models of other training seeds.

    Parameters
    ----------
    groups : samples of each group, not empty.
    statistic : function of a vector of samples.

    Examples
    --------
    >>> nested_bootstrap([[1.0, 1.0], [3.0, 3.0]])
    Interval(estimate=2.0, low=1.0, high=3.0, n=4)
    """
    if not len(groups):
        raise ConfigError("a nested bootstrap needs at least one group of samples")
    samples = [_samples(each) for each in groups]
    whole = np.concatenate(samples)
    if np.ptp(whole) == 0.0:
        return Interval(float(statistic(whole)), float(whole[0]), float(whole[0]), int(whole.size))
    rng, found = np.random.default_rng(_SEED), np.empty(_NESTED_RESAMPLES)
    for k in range(_NESTED_RESAMPLES):
        drawn = [samples[g] for g in rng.integers(len(samples), size=len(samples))]
        found[k] = statistic(np.concatenate([each[rng.integers(each.size, size=each.size)] for each in drawn]))
    low, high = np.quantile(found, [(1 - confidence) / 2, (1 + confidence) / 2])
    return Interval(float(statistic(whole)), float(low), float(high), int(whole.size))


def paired_difference(first: ArrayLike, second: ArrayLike, confidence: float = CONFIDENCE) -> Interval:
    """Mean of `first - second` over pairs, with its bootstrap interval.

    Examples
    --------
    >>> paired_difference([3.0, 5.0], [1.0, 3.0]).estimate
    2.0
    """
    left, right = _pairs(first, second)
    return bootstrap_mean(left - right, confidence)


def paired_rate_difference(first: ArrayLike, second: ArrayLike, confidence: float = CONFIDENCE) -> Interval:
    """Difference of the rates of two paired binary outcomes, with the Bonett-Price interval.

    A bootstrap interval would have width 0 if all pairs agree; this one does not.
    Source: Bonett and Price 2012, adjusted Wald interval for paired proportions.

    Examples
    --------
    >>> interval = paired_rate_difference([0, 0, 0], [0, 0, 0])
    >>> interval.estimate, interval.low < 0 < interval.high
    (0.0, True)
    """
    left, right = (side.astype(bool) for side in _pairs(first, second))
    n, gained, lost = int(left.size), int(np.sum(left & ~right)), int(np.sum(~left & right))
    p, q = (gained + 1) / (n + 2), (lost + 1) / (n + 2)
    z = float(stats.norm.ppf((1 + confidence) / 2))
    half = z * float(np.sqrt(max(p + q - (p - q) ** 2, 0.0) / (n + 2)))
    estimate = (gained - lost) / n
    low, high = max(p - q - half, -1.0), min(p - q + half, 1.0)
    return Interval(estimate, min(low, estimate), max(high, estimate), n)


def mcnemar(first: ArrayLike, second: ArrayLike) -> McNemar:
    """Test whether two paired binary outcomes (crashed with, crashed without) differ in rate.

    Examples
    --------
    >>> mcnemar([True] * 6, [False] * 6).p_value
    0.03125
    """
    left, right = (side.astype(bool) for side in _pairs(first, second))
    only_first, only_second = int(np.sum(left & ~right)), int(np.sum(~left & right))
    discordant = only_first + only_second
    p_value = 1.0 if discordant == 0 else float(stats.binomtest(only_first, discordant).pvalue)
    return McNemar(only_first, only_second, p_value, int(left.size))


def quantiles(values: ArrayLike, levels: Sequence[float] = (0.5, 0.99)) -> tuple[float, ...]:
    """Quantiles of pooled samples; NaN without samples (an unshielded run has no latencies)."""
    samples = np.asarray(values, dtype=float)
    if samples.size == 0:
        return tuple(float("nan") for _ in levels)
    return tuple(float(q) for q in np.quantile(samples, levels))


def _samples(values: ArrayLike) -> NDArray[np.float64]:
    samples = np.asarray(values, dtype=float)
    if samples.ndim != 1 or samples.size == 0 or not np.all(np.isfinite(samples)):
        raise ConfigError(
            f"samples must be a non-empty finite vector, got shape {samples.shape}"
            f" with {int(np.sum(~np.isfinite(samples)))} values that are not finite"
        )
    return samples


def _pairs(first: ArrayLike, second: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    left, right = _samples(first), _samples(second)
    if left.shape != right.shape:
        raise ConfigError(f"pairs need equal lengths, got {left.size} and {right.size}")
    return left, right
