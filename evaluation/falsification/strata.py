r"""Stratified estimate of the probability of a rare event on the highway, by the number of vehicles in the ego's lane.

Notation
--------
Lanes are integers, and a crash of one kind is not near a crash of another kind. So scenes are sorted by K, the number
of the m other vehicles that start in the ego's lane. K is binomial, with m trials of probability one over the number of
lanes. Inside each stratum the rest is drawn as in a reset,

    P(F) = sum_k P(K = k) P(F | K = k)

A pilot with the same number of episodes in each stratum sets the allocation of the main sample. It is proportional to
P(K = k) sqrt(P(F | K = k)), plus an even share so that no stratum is empty. The estimate uses the main sample alone, so
it is unbiased for every result of the pilot.

Source: Neyman 1934 (allocation); Cochran 1977, chapter 5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import binom

from dynamics.errors import ConfigError
from dynamics.state import BoolArray, FloatArray, IntArray

__all__ = ["Strata", "Stratified", "stratified"]

_EVEN = 0.15
"""Share of the main sample that is spread evenly over the strata."""
_MOST = float(np.nextafter(1.0, 0.0))


@dataclass(frozen=True, slots=True)
class Strata:
    """Scenes with `others` vehicles on `lanes` lanes, by how many share the ego's lane (see `Simulator.draws`)."""

    others: int
    lanes: int

    def __post_init__(self) -> None:
        if self.others < 1 or self.lanes < 2:
            raise ConfigError(f"have at least 1 other and 2 lanes, not {self.others} and {self.lanes}")

    @property
    def probabilities(self) -> FloatArray:
        """Probability of each stratum, (others + 1,)."""
        found: FloatArray = binom.pmf(np.arange(self.others + 1), self.others, 1 / self.lanes)
        return found

    def draw(self, stratum: int, count: int, rng: np.random.Generator) -> FloatArray:
        """Random numbers of `count` scenes of a stratum, (count, draws)."""
        uniforms = rng.random((count, 2 + 4 * self.others))
        ego = (uniforms[:, 0] * self.lanes).astype(np.intp)
        same = rng.permuted(np.tile(np.arange(self.others) < stratum, (count, 1)), axis=1)
        away = rng.integers(1, self.lanes, (count, self.others))
        lanes = (ego[:, None] + np.where(same, 0, away)) % self.lanes
        uniforms[:, 2::4] = (lanes + rng.random(lanes.shape)) / self.lanes
        return np.minimum(uniforms, _MOST)


@dataclass(frozen=True, slots=True, eq=False)
class Stratified:
    """Result of a stratified estimate.

    Attributes
    ----------
    probability : the estimate.
    error : its standard error, from the counts.
    evaluations : number of episodes, with the pilot.
    counted : episodes of each stratum, without the pilot, (others + 1,).
    met : episodes with the event among them, (others + 1,).
    """

    probability: float
    error: float
    evaluations: int
    counted: IntArray
    met: IntArray


def stratified(
    happens: Callable[[FloatArray], BoolArray], strata: Strata, pilot: int = 600, last: int = 12_000, seed: int = 0
) -> Stratified:
    """Estimate the probability of an event in scenes with the distribution of a reset.

    Parameters
    ----------
    happens : whether the event occurs, (n,), in scenes made from random numbers (n, draws).
    strata : the strata of the scenes.
    pilot : episodes of each stratum in the pilot, which only sets the allocation.
    last : approximate number of episodes of the main sample.
    seed : seed of the random numbers.

    Raises
    ------
    ConfigError
        If the pilot or the main sample is too small.
    """
    of_each = strata.probabilities
    k = len(of_each)
    if pilot < 1 or last < 10 * k:
        raise ConfigError(f"have a pilot of at least 1 and at least {10 * k} to count, not {pilot} and {last}")
    rng = np.random.default_rng(seed)
    seen = np.array([happens(strata.draw(i, pilot, rng)).sum() for i in range(k)])
    worth = of_each * np.sqrt(seen / pilot)
    worth = worth / worth.sum() if seen.any() else np.full(k, 1 / k)
    counted = np.maximum(np.rint(last * (_EVEN / k + (1 - _EVEN) * worth)).astype(np.intp), 2)
    met = np.array([happens(strata.draw(i, int(n), rng)).sum() for i, n in enumerate(counted)])
    rates = met / counted
    variance = float((of_each**2 * rates * (1 - rates) / (counted - 1)).sum())
    return Stratified(float(of_each @ rates), float(np.sqrt(variance)), k * pilot + int(counted.sum()), counted, met)
