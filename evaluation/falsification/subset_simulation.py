r"""Subset simulation: the probability of a rare event, as a product of probabilities that are not small.

Notation
--------
x ~ N(0, I) of d numbers, a performance g(x), and the event F = {g <= 0}. With levels b_1 > b_2 > ... > b_K = 0,

    P(F) = P(g <= b_1) * prod_k P(g <= b_k | g <= b_{k-1})

Each level is the p0-quantile of the samples of the level before. Each conditional probability is estimated from Markov
chains that start at those samples. A move proposes x' = sqrt(1 - s^2) x + s xi, xi ~ N(0, I), which preserves N(0, I),
and is accepted where g(x') <= b. The step s adapts until 44 % of the moves are accepted. A dimension without a notion
of nearness, such as a seed, has no small moves: most moves keep it and the others draw it anew, which preserves N(0, I)
too.

Sources: Au and Beck 2001 (subset simulation); Papaioannou, Betz, Zwirglmaier and Straub 2015 (conditional sampling and
how s adapts); Cotter, Roberts, Stuart and White 2013 (the move).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynamics.errors import ConfigError
from dynamics.state import BoolArray, FloatArray

__all__ = ["MOST_SHARE", "Level", "Subset", "subset_simulation"]

Performance = Callable[[FloatArray], FloatArray]
"""g of points (n, d), (n,): the event occurs where it is not positive."""

_ACCEPTED, _FIRST_STEP = 0.44, 0.6
"""Target acceptance rate, and the first s."""
_MOST_LEVELS = 20
_JUMPS = 0.1
"""Share of the moves that draw the dimensions without nearness anew."""
MOST_SHARE = float(np.nextafter(1.0, 0.0))
"""The greatest number below 1: upper limit for the normal distribution function of a point."""


@dataclass(frozen=True, slots=True)
class Level:
    """One level.

    Attributes
    ----------
    bound : b, 0 at the last level.
    probability : share of the samples of the level before that are within the bound.
    accepted : acceptance rate of the moves that led to this level; NaN for the first.
    """

    bound: float
    probability: float
    accepted: float


@dataclass(frozen=True, slots=True, eq=False)
class Subset:
    """Result of a subset simulation.

    Attributes
    ----------
    probability : the estimate.
    variation : its coefficient of variation, with the correlation within chains but not between levels: a lower
        bound; infinite if the event was not reached.
    evaluations : number of evaluations of the performance.
    levels : the levels, in order.
    points, performance : samples of the last level, (n, d) and (n,), the worst first.
    """

    probability: float
    variation: float
    evaluations: int
    levels: tuple[Level, ...]
    points: FloatArray
    performance: FloatArray


def subset_simulation(
    performance: Performance,
    dimensions: int,
    samples: int = 1000,
    share: float = 0.1,
    seed: int = 0,
    most: int | None = None,
    jumps: int = 0,
) -> Subset:
    """Estimate P(g <= 0) for a standard normal distribution of `dimensions` numbers.

    Parameters
    ----------
    performance : g.
    samples : samples of each level.
    share : p0; `samples * share` and `1 / share` have to be whole numbers.
    seed : seed of the random numbers.
    most : number of evaluations after which no further level begins. The estimate is then 0 without the event.
    jumps : number of leading dimensions without nearness.

    Raises
    ------
    ConfigError
        If the numbers are inconsistent.

    Examples
    --------
    >>> found = subset_simulation(lambda x: 4.0 - x[:, 0], 3, seed=1)  # P = 3.17e-5
    >>> 1e-5 < found.probability < 1e-4
    True
    """
    chains, length = _chains_of(samples, share)
    if not 0 <= jumps <= dimensions:
        raise ConfigError(f"have from 0 to {dimensions} dimensions without neighbours, not {jumps}")
    rng = np.random.default_rng(seed)
    points = rng.standard_normal((samples, dimensions))
    g = _evaluate_checked(performance, points)
    evaluations, probability, variance, step, taken = samples, 1.0, 0.0, _FIRST_STEP, np.nan
    levels: list[Level] = []
    of_chains = np.arange(samples)[None]  # in the first level each sample is a chain of one
    while True:
        order = np.argsort(g, kind="stable")
        points, g = points[order], g[order]
        of_chains = np.argsort(order)[of_chains]
        bound = 0.5 * (g[chains - 1] + g[chains])
        last = bound <= 0 or len(levels) == _MOST_LEVELS or (most is not None and evaluations >= most)
        inside = g <= (0.0 if last else bound)
        within = float(inside.mean())
        levels.append(Level(0.0 if last else float(bound), within, float(taken)))
        probability *= within
        variance += _variance(inside[of_chains], within)
        if last:
            variation = float(np.sqrt(variance)) if probability > 0 else np.inf
            return Subset(probability, variation, evaluations, tuple(levels), points, g)
        # The best samples start the chains: they have the conditional distribution of this level already.
        runs = _Chains(performance, bound, jumps, rng, step).run(points[:chains].copy(), g[:chains].copy(), length)
        points, g, taken, step = runs
        evaluations += chains * (length - 1)
        of_chains = np.arange(samples).reshape(length, chains)


def _chains_of(samples: int, share: float) -> tuple[int, int]:
    """Number and length of the chains of a level."""
    chains, length = round(samples * share), round(1 / share)
    if chains < 2 or chains * length != samples:
        raise ConfigError(f"{samples} samples cannot be chains of {1 / share:g} each; have such as 1000 with 0.1")
    return chains, length


@dataclass(slots=True, eq=False)
class _Chains:
    """Markov chains of one level.

    Attributes
    ----------
    performance : g. bound : b. jumps : number of leading dimensions without nearness. step : s, which adapts.
    """

    performance: Performance
    bound: float
    jumps: int
    rng: np.random.Generator
    step: float

    def run(self, x: FloatArray, g: FloatArray, length: int) -> tuple[FloatArray, FloatArray, float, float]:
        """Samples of the chains from points x, (chains, d), with performance g, (chains,), both overwritten. Then the
        acceptance rate and the last step."""
        points, found, moved = [x.copy()], [g.copy()], 0
        for _ in range(length - 1):
            proposed = self._proposed(x)
            then = _evaluate_checked(self.performance, proposed)
            good = then <= self.bound
            x[good], g[good] = proposed[good], then[good]
            points.append(x.copy())
            found.append(g.copy())
            moved += int(good.sum())
            self.step = float(np.clip(self.step * np.exp(good.mean() - _ACCEPTED), 1e-3, 1.0))
        return np.concatenate(points), np.concatenate(found), moved / (len(x) * (length - 1)), self.step

    def _proposed(self, x: FloatArray) -> FloatArray:
        """Moves of the chains from points x, (chains, d)."""
        (chains, dimensions), step, jumps = x.shape, self.step, self.jumps
        proposed: FloatArray = np.sqrt(1 - step**2) * x + step * self.rng.standard_normal(x.shape)
        if jumps:
            # If all dimensions jump, every move draws anew: otherwise it would change nothing.
            kept = self.rng.random((chains,)) >= (_JUMPS if jumps < dimensions else 1.0)
            proposed[:, :jumps] = np.where(kept[:, None], x[:, :jumps], self.rng.standard_normal((chains, jumps)))
        return proposed


def _evaluate_checked(performance: Performance, points: FloatArray) -> FloatArray:
    g = np.asarray(performance(points), float)
    if g.shape != (len(points),) or np.isnan(g).any():
        raise ConfigError(f"a performance has a number for each of {len(points)} points, not shape {g.shape} or NaN")
    return g


def _variance(inside: BoolArray, within: float) -> float:
    """Squared coefficient of variation of a conditional probability, from indicators along chains, (length, chains).

    Source: Au and Beck 2001, equations 22 to 26.
    """
    length, chains = inside.shape
    if within in (0.0, 1.0):
        return 0.0
    centred, correlation = inside - within, 0.0
    for lag in range(1, length):
        covariance = float((centred[:-lag] * centred[lag:]).sum()) / ((length - lag) * chains)
        correlation += 2 * (1 - lag / length) * covariance / (within * (1 - within))
    found: float = (1 - within) / (within * length * chains) * (1 + max(correlation, 0.0))
    return found
