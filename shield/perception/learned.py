"""What innovations say of a sensor: how noisy it is, and how far what it shows is from what was expected.

Both are values: `after` gives what is known one observation later, and nothing is kept elsewhere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.special import ndtr

from dynamics.state import FloatArray
from shield.perception.filters import FARTHEST
from shield.perception.tracking import Surprise

__all__ = ["RESOLUTION", "WIDEST", "Conformal", "Learned", "Noise"]

RESOLUTION = np.full(4, 1e-4)
"""What 32 bits leave of x, y [m], vx and vy [m/s] in an observation: no sensor is taken to be better."""
WIDEST = np.array([100.0, 6.0, 40.0, 40.0])
"""Standard deviations of x, y [m], vx and vy [m/s] of the worst sensor that there is taken to be, and of one of which
nothing is known: half the ranges of highway-env's normalised features on three lanes."""
_MEMORY = 600.0
"""What was seen so many vehicles ago counts 1/e as much as what is seen now."""
_FREE = 2.0 / 3.0
"""Two differences in a row share an observation: what they tell is that of so many independent ones."""
_DOUBT = 1.645
"""The noise is taken to be as large as it is with 95 %."""
_FARTHEST_STEP, _FEW = 3.0, 10.0
"""A difference counts for no more than so many standard deviations by what is known, once it is of more than so many:
one that swings from lane to lane says nothing of the sensor."""

_BINS = 640
_EDGES = np.linspace(-FARTHEST, FARTHEST, _BINS + 1)
_RECENT = 2_000.0
_PRIOR = 200.0
"""The normal distribution counts as so many vehicles that have been seen."""
_GAMMA = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """How noisy a sensor is, from the differences between two observations in a row of the same vehicle.

    A difference, but for how far the vehicle has come, is that of two draws of noise and what the vehicle has done that
    could not be foreseen: half its square is, in the mean, the variance of the noise, or more. It depends on no filter,
    and so on no noise that was assumed before. Squares beyond 3 standard deviations are cut off: that leaves normal
    noise as it is, and takes up to a tenth off that of Student's t with 3 degrees of freedom.

    Attributes
    ----------
    squares : sum of half the squared differences of x, y, vx and vy, (4,). count : how many; both forget.
    """

    squares: FloatArray = field(default_factory=lambda: np.zeros(4))
    count: float = 0.0

    def after(self, steps: FloatArray) -> Noise:
        """With what `Surprise.steps` (l, 4) says."""
        left, squares = math.exp(-len(steps) / _MEMORY), 0.5 * np.square(steps)
        if self.count > _FEW:
            squares = np.minimum(squares, _FARTHEST_STEP**2 * self.squares / self.count)
        return Noise(left * self.squares + squares.sum(axis=0), left * self.count + len(steps))

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations of x, y [m], vx and vy [m/s], (4,): the upper end of an interval of confidence, which is
        wide while few have been seen (chi^2 after Wilson and Hilferty 1931)."""
        free = _FREE * self.count
        share = 1.0 - 2.0 / (9.0 * free) - _DOUBT * math.sqrt(2.0 / (9.0 * free)) if free else 0.0
        if share <= 0.0:
            return WIDEST.copy()
        found: FloatArray = np.clip(np.sqrt(self.squares / (self.count * share**3)), RESOLUTION, WIDEST)
        return found


def _normal() -> FloatArray:
    return np.tile(_PRIOR * np.diff(ndtr(_EDGES)), (4, 1))


@dataclass(frozen=True, slots=True, eq=False)
class Conformal:
    """How many standard deviations bounds have to be away, so that what is seen next is beyond them as often as chosen.

    Adaptive conformal inference (Gibbs and Candes 2021): the bound on each side is the quantile of the scores so far
    (`Surprise.scores`) at a level that goes up by gamma (chosen - missed) with each vehicle that is seen. So in the
    long run it is missed as often as chosen, whatever the distribution, and however the traffic reacts to the ego.
    Recent scores count more (weights as of Barber et al. 2023).

    Attributes
    ----------
    counts : of the scores of x, y, vx and vy, by bins from -`FARTHEST` to `FARTHEST`, (4, bins).
    levels : how often to be missed, below and above, of each, (2, 4); what is at most 0 has no bound but `FARTHEST`.
    chosen : how often is asked for.
    """

    chosen: float
    levels: FloatArray
    counts: FloatArray = field(default_factory=_normal)

    @classmethod
    def of(cls, bound: float) -> Conformal:
        """Before anything is seen: those of a normal distribution that is missed beyond so many standard deviations."""
        chosen = float(ndtr(-bound))
        return cls(chosen, np.full((2, 4), chosen))

    @property
    def bounds(self) -> FloatArray:
        """Below and above, of each of x, y, vx and vy, (2, 4), from 0 to `FARTHEST` standard deviations."""
        shares = self.counts.cumsum(axis=1) / self.counts.sum(axis=1, keepdims=True)
        found = np.empty((2, 4))
        for k in range(4):
            below, above = self.levels[:, k]
            # Outward: the edge of the bin that is on the far side.
            found[0, k] = -_EDGES[np.searchsorted(shares[k], below, side="right")] if below > 0 else FARTHEST
            at = np.searchsorted(shares[k], 1.0 - above, side="left") + 1 if above > 0 else _BINS
            found[1, k] = _EDGES[min(at, _BINS)]
        return np.clip(found, 0.0, FARTHEST)

    def missed(self, scores: FloatArray) -> FloatArray:
        """Who is beyond the bounds, below and above, (2, k, 4)."""
        low, high = self.bounds
        # A score stops at the last bound that there is.
        return np.stack([(scores < -low) | (scores <= -FARTHEST), (scores > high) | (scores >= FARTHEST)])

    def after(self, scores: FloatArray) -> Conformal:
        """With what `Surprise.scores` (k, 4) says."""
        n = len(scores)
        levels = self.levels + _GAMMA * (n * self.chosen - self.missed(scores).sum(axis=1))
        counts = math.exp(-n / _RECENT) * self.counts
        bins = np.clip(((scores + FARTHEST) * (0.5 * _BINS / FARTHEST)).astype(np.intp), 0, _BINS - 1)
        np.add.at(counts, (np.arange(4), bins), 1.0)
        return Conformal(self.chosen, levels, counts)


@dataclass(frozen=True, slots=True, eq=False)
class Learned:
    """What is known of a sensor.

    Attributes
    ----------
    noise : how noisy it is; None where that is told.
    conformal : how far bounds have to be away; None where they are those of a normal distribution.
    """

    noise: Noise | None = None
    conformal: Conformal | None = None

    def after(self, surprise: Surprise) -> Learned:
        """With one more observation."""
        return Learned(
            None if self.noise is None else self.noise.after(surprise.steps),
            None if self.conformal is None else self.conformal.after(surprise.scores),
        )
