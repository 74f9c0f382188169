"""Whether a sensor behaves as it is thought to: what was expected against what is seen, in the frames of a decision."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynamics.state import FloatArray

__all__ = ["Monitor"]

_CAP = 25.0
"""No vehicle counts more than this squared distance: one that swings, or is taken for another, is no alarm."""
_USUAL, _LIMIT = 8.0, 12.0
"""An alarm is where the sum of n squared distances is above n times the first, and above that by more than the second
times the root of n. Chosen on episodes with noise as told, with tails (Student's t with 3 degrees of freedom times what
was told), and three times as large: `benchmarks/monitor.py --seed 2000`."""


@dataclass(frozen=True, slots=True)
class Monitor:
    """The test of the innovations of the last frames: an alarm where their squared distances add up to too much.

    Where noise is normal and as told the distances have a mean of 4 or less (chi^2 with 4 degrees of freedom, and
    motions that are foreseen with some reserve); with noise three times as large, of more than 10.

    Attributes
    ----------
    recent : of each observation, its frame, the sum of the squared distances, and of how many.
    """

    recent: tuple[tuple[int, float, int], ...] = ()

    def after(self, frame: int, distances: FloatArray, frames: int) -> Monitor:
        """With what `Surprise.distances` (k,) says at a frame; what is `frames` old, or older, counts no more."""
        new = frame, float(np.minimum(distances, _CAP).sum()), len(distances)
        return Monitor((*(each for each in self.recent if each[0] > frame - frames), new))

    @property
    def excess(self) -> float:
        """How far the sum is above what is usual, by the root of how many there are."""
        count = sum(n for *_, n in self.recent)
        total = sum(each for _, each, _ in self.recent)
        return (total - _USUAL * count) / math.sqrt(count) if count else 0.0

    @property
    def alarmed(self) -> bool:
        """Whether the sensor does not behave as it is thought to."""
        return self.excess > _LIMIT
