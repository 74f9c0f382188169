"""Estimates about a sensor from its innovations: the noise, and the frequency of prediction errors.

Both are values: `after` returns the estimate after one more observation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.special import ndtr

from dynamics.state import FloatArray
from shield.perception.filters import SCORE_LIMIT
from shield.perception.tracking import Innovations

__all__ = ["RESOLUTION", "WIDEST", "Conformal", "Learned", "Noise"]

RESOLUTION = np.full(4, 1e-4)
"""Resolution of x, y [m], vx and vy [m/s] in a 32-bit observation: least standard deviation of a sensor."""
WIDEST = np.array([100.0, 6.0, 40.0, 40.0])
"""Greatest standard deviations of x, y [m], vx and vy [m/s], also assumed of an unknown sensor: half the ranges of
highway-env's normalised features on three lanes."""
_MEMORY = 600.0
"""The weight of an observed vehicle falls to 1/e after this many further vehicles."""
_FREE = 2.0 / 3.0
"""Share of independent differences: two successive differences share an observation."""
_DOUBT = 1.645
"""Normal quantile of the upper confidence limit of the noise, which is at 95 %."""
_FARTHEST_STEP, _FEW = 3.0, 10.0
"""From this many differences on (the second number), a difference is capped at this many present standard deviations
(the first). A vehicle that changes lanes carries no information about the sensor."""

_BINS = 640
_EDGES = np.linspace(-SCORE_LIMIT, SCORE_LIMIT, _BINS + 1)
_RECENT = 2_000.0
_PRIOR = 200.0
"""Weight of the prior normal distribution, as a number of observed vehicles."""
_GAMMA = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """Estimate of a sensor's noise from differences between two successive observations of the same vehicle.

    A difference, less the distance driven, is the sum of two noise samples and of unpredicted motion. So half its
    square has a mean of at least the variance of the noise. The estimate depends on no filter, and so on no earlier
    assumption about the noise. Squares beyond 3 standard deviations are capped. The cap keeps normal noise, and lowers
    Student's t with 3 degrees of freedom by up to a tenth.

    Attributes
    ----------
    squares : sum of half the squared differences of x, y, vx and vy, (4,). count : their number. Both decay
        exponentially.
    """

    squares: FloatArray = field(default_factory=lambda: np.zeros(4))
    count: float = 0.0

    def after(self, steps: FloatArray) -> Noise:
        """Estimate with `Innovations.steps` (l, 4) added."""
        left, squares = math.exp(-len(steps) / _MEMORY), 0.5 * np.square(steps)
        if self.count > _FEW:
            squares = np.minimum(squares, _FARTHEST_STEP**2 * self.squares / self.count)
        return Noise(left * self.squares + squares.sum(axis=0), left * self.count + len(steps))

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations of x, y [m], vx and vy [m/s], (4,): the upper confidence limit, which is wide after few
        observations (chi^2 after Wilson and Hilferty 1931)."""
        free = _FREE * self.count
        share = 1.0 - 2.0 / (9.0 * free) - _DOUBT * math.sqrt(2.0 / (9.0 * free)) if free else 0.0
        if share <= 0.0:
            return WIDEST.copy()
        found: FloatArray = np.clip(np.sqrt(self.squares / (self.count * share**3)), RESOLUTION, WIDEST)
        return found


def _normal() -> FloatArray:
    """Initial counts: the bins of a normal distribution, (4, bins)."""
    return np.tile(_PRIOR * np.diff(ndtr(_EDGES)), (4, 1))


@dataclass(frozen=True, slots=True, eq=False)
class Conformal:
    """Bounds in standard deviations that the next observation exceeds with a chosen frequency.

    Adaptive conformal inference (Gibbs and Candes 2021): the bound on each side is the quantile of the scores so far
    (`Innovations.scores`) at a level. Each observed vehicle raises the level by gamma (chosen - missed). In the long
    run the bounds are missed with the chosen frequency, for any distribution and any reaction of the traffic to the
    ego. Recent scores weigh more (weights as in Barber et al. 2023).

    Attributes
    ----------
    chosen : the chosen frequency.
    levels : present levels below and above, for each of x, y, vx and vy, (2, 4). A level of at most 0 gives the bound
        `SCORE_LIMIT`.
    counts : histogram of the scores of x, y, vx and vy, in bins from -`SCORE_LIMIT` to `SCORE_LIMIT`, (4, bins).
    """

    chosen: float
    levels: FloatArray
    counts: FloatArray = field(default_factory=_normal)

    @classmethod
    def of(cls, bound: float) -> Conformal:
        """Initial state: a normal distribution and the frequency with which it exceeds `bound` standard deviations."""
        chosen = float(ndtr(-bound))
        return cls(chosen, np.full((2, 4), chosen))

    @property
    def bounds(self) -> FloatArray:
        """Bounds below and above, for each of x, y, vx and vy, (2, 4), from 0 to `SCORE_LIMIT` standard deviations."""
        cumulative = self.counts.cumsum(axis=1) / self.counts.sum(axis=1, keepdims=True)
        found = np.empty((2, 4))
        for k in range(4):
            below, above = self.levels[:, k]
            # Conservative rounding: the outer edge of the bin.
            found[0, k] = -_EDGES[np.searchsorted(cumulative[k], below, side="right")] if below > 0 else SCORE_LIMIT
            at = np.searchsorted(cumulative[k], 1.0 - above, side="left") + 1 if above > 0 else _BINS
            found[1, k] = _EDGES[min(at, _BINS)]
        return np.clip(found, 0.0, SCORE_LIMIT)

    def missed(self, scores: FloatArray) -> FloatArray:
        """Which scores are beyond the bounds, below and above, (2, k, 4)."""
        low, high = self.bounds
        # A score is capped at `SCORE_LIMIT`, so a score there counts as beyond.
        return np.stack([(scores < -low) | (scores <= -SCORE_LIMIT), (scores > high) | (scores >= SCORE_LIMIT)])

    def after(self, scores: FloatArray) -> Conformal:
        """State with `Innovations.scores` (k, 4) added."""
        n = len(scores)
        levels = self.levels + _GAMMA * (n * self.chosen - self.missed(scores).sum(axis=1))
        counts = math.exp(-n / _RECENT) * self.counts
        bins = np.clip(((scores + SCORE_LIMIT) * (0.5 * _BINS / SCORE_LIMIT)).astype(np.intp), 0, _BINS - 1)
        np.add.at(counts, (np.arange(4), bins), 1.0)
        return Conformal(self.chosen, levels, counts)


@dataclass(frozen=True, slots=True, eq=False)
class Learned:
    """Estimates about a sensor.

    Attributes
    ----------
    noise : estimate of the noise; None where the noise is configured.
    conformal : estimate of the bounds; None where they are those of a normal distribution.
    """

    noise: Noise | None = None
    conformal: Conformal | None = None

    def after(self, surprise: Innovations) -> Learned:
        """Estimates with one more observation added."""
        return Learned(
            None if self.noise is None else self.noise.after(surprise.steps),
            None if self.conformal is None else self.conformal.after(surprise.scores),
        )
