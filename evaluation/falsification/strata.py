r"""Stratified counting: the probability of a rare event on the highway, by how many share the ego's lane.

Notation
--------
Lanes are drawn as whole numbers, and a crash of one kind is not near one of another. So scenes are sorted by K, how
many of the m others start in the ego's lane: binomial, with m and one over the number of lanes. Inside each stratum the
rest is drawn as it comes,

    P(F) = sum_k P(K = k) P(F | K = k)

A pilot of as many episodes in each says where the others are worth most: in proportion to P(K = k) sqrt(P(F | K = k)),
and a share of them evenly, so that no stratum is without. The estimate is made of those others alone, so it is
unbiased, whatever the pilot saw.

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
"""Share of the episodes that are spread evenly."""
_MOST = float(np.nextafter(1.0, 0.0))


@dataclass(frozen=True, slots=True)
class Strata:
    """Scenes of so many others on so many lanes, by how many of them share the ego's (see `Simulator.draws`)."""

    others: int
    lanes: int

    def __post_init__(self) -> None:
        if self.others < 1 or self.lanes < 2:
            raise ConfigError(f"have at least 1 other and 2 lanes, not {self.others} and {self.lanes}")

    @property
    def probabilities(self) -> FloatArray:
        """Of each stratum, (others + 1,)."""
        found: FloatArray = binom.pmf(np.arange(self.others + 1), self.others, 1 / self.lanes)
        return found

    def draw(self, stratum: int, count: int, rng: np.random.Generator) -> FloatArray:
        """The numbers that so many scenes of a stratum are made from, (count, draws)."""
        shares = rng.random((count, 2 + 4 * self.others))
        ego = (shares[:, 0] * self.lanes).astype(np.intp)
        same = rng.permuted(np.tile(np.arange(self.others) < stratum, (count, 1)), axis=1)
        away = rng.integers(1, self.lanes, (count, self.others))
        lanes = (ego[:, None] + np.where(same, 0, away)) % self.lanes
        shares[:, 2::4] = (lanes + rng.random(lanes.shape)) / self.lanes
        return np.minimum(shares, _MOST)


@dataclass(frozen=True, slots=True, eq=False)
class Stratified:
    """What was found.

    Attributes
    ----------
    probability : the estimate. error : its standard error, as the counts tell.
    evaluations : episodes, the pilot's included. counted, met : of each stratum, without the pilot: episodes, and those
        with the event.
    """

    probability: float
    error: float
    evaluations: int
    counted: IntArray
    met: IntArray


def stratified(
    happens: Callable[[FloatArray], BoolArray], strata: Strata, pilot: int = 600, last: int = 12_000, seed: int = 0
) -> Stratified:
    """Estimate how often something happens in scenes as a reset draws them.

    Parameters
    ----------
    happens : whether it does, (n,), in scenes made from numbers (n, draws).
    pilot : episodes in each stratum that only say where to count. last : those that are counted, about.
    seed : of what is drawn.

    Raises
    ------
    ConfigError
        If there are too few of either.
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
