"""What the bends of a road cost a judgement in its frame, at worst: bounds over the whole road, computed once.

Notation
--------
On a path of curvature k a vehicle at lateral position r [m] that drives d metres passes d / (1 - k r) metres of the
path: its *stretch* is 1 / (1 - k r). A car is no rectangle in the road's frame; `dynamics.roads.footprint` has what it
takes to contain it. A bicycle that follows the bend points inwards by its slip angle, asin(k / (1 - k r) L / 2).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dynamics.roads.footprint import bend_growth
from dynamics.state import FloatArray

__all__ = ["Bends"]

_HEADINGS = np.linspace(-1.0, 1.0, 41)
"""Headings over which a footprint is bounded [rad]; beyond, a car stands across the road."""
_KINK = 0.1
"""How far the lanes of a map that does not fit together may point away from the path [rad] (racetrack-v0: 0.09)."""


@dataclass(frozen=True)
class Bends:
    """Bounds over a road.

    Parameters
    ----------
    least, greatest : curvature of its path [1/m].
    low, high : lateral positions of its edges [m].
    deviation : how far the lanes of the map are from the road's at most [m].
    """

    least: float
    greatest: float
    low: float
    high: float
    deviation: float
    _grown: dict[tuple[float, float], tuple[float, float]] = field(default_factory=dict, repr=False, compare=False)

    def stretch(self, r: Any) -> tuple[FloatArray, FloatArray]:
        """Least and greatest metres of the path that a metre at lateral positions `r` [m] covers."""
        inside = np.minimum(np.maximum(r, self.low), self.high)
        both = np.stack([1 / (1 - k * inside) for k in (self.least, self.greatest)])
        return both.min(axis=0), both.max(axis=0)

    def growth(self, length: float, width: float) -> tuple[float, float]:
        """Extra half extents (along, across) [m] that a rectangle needs to contain a car anywhere on the road."""
        key = (float(length), float(width))
        if key not in self._grown:
            # The growth is greatest where the curvature is, and at an edge.
            psi, r, k = np.meshgrid(
                _HEADINGS, np.linspace(self.low, self.high, 9), [self.least, self.greatest], indexing="ij"
            )
            inside = k * r + np.abs(k) * np.hypot(*key) / 2 < 1
            along, across = bend_growth(*key, psi[inside], r[inside], k[inside])
            self._grown[key] = float(along.max(initial=0.0)), float(across.max(initial=0.0)) + self.deviation
        return self._grown[key]

    def slip(self, length: float) -> float:
        """How far a vehicle of that length [m] that keeps its lane may point away from the path [rad]."""
        tightest = max(abs(k) / (1 - k * r) for k in (self.least, self.greatest) for r in (self.low, self.high))
        return float(np.arcsin(min(0.5 * length * tightest, 1.0))) + (_KINK if self.deviation > 0 else 0.0)
