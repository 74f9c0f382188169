"""Test whether a sensor behaves as assumed, from the innovations of the frames of a decision."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynamics.state import FloatArray

__all__ = ["SensorMonitor"]

_CAP = 25.0
"""Greatest squared distance that one vehicle contributes. A lateral swing, or a wrong match, causes no alarm."""
_USUAL, _LIMIT = 8.0, 12.0
"""The sum S of n squared distances causes an alarm if S > 8 n + 12 √n. Chosen on episodes with noise as configured,
with heavy tails (Student's t with 3 degrees of freedom), and with three times the noise: `benchmarks/monitor.py --seed
2000`."""


@dataclass(frozen=True, slots=True)
class SensorMonitor:
    """Test of the innovations of the last frames: the alarm compares the sum of their squared distances with a
    threshold.

    With normal noise as configured the distances have a mean of at most 4 (chi^2 with 4 degrees of freedom, and
    conservative process noise). With three times the noise their mean is above 10.

    Attributes
    ----------
    recent : for each observation its frame, the sum of its squared distances, and their number.
    """

    recent: tuple[tuple[int, float, int], ...] = ()

    def after(self, frame: int, distances: FloatArray, frames: int) -> SensorMonitor:
        """Monitor with `Innovations.distances` (k,) of one more frame; entries at least `frames` old are dropped."""
        new = frame, float(np.minimum(distances, _CAP).sum()), len(distances)
        return SensorMonitor((*(each for each in self.recent if each[0] > frame - frames), new))

    @property
    def excess(self) -> float:
        """Excess of the sum over its usual value, divided by the square root of the number of distances."""
        count = sum(n for *_, n in self.recent)
        total = sum(each for _, each, _ in self.recent)
        return (total - _USUAL * count) / math.sqrt(count) if count else 0.0

    @property
    def alarmed(self) -> bool:
        """Whether the sensor does not behave as assumed."""
        return self.excess > _LIMIT
