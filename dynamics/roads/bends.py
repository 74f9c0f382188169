"""Worst-case effects of the bends of a road in its road frame: bounds over the whole road, computed once.

Notation
--------
On a path of curvature k, a vehicle at lateral position r [m] that drives d metres passes d / (1 - k r) metres of the
path. Its *stretch* is 1 / (1 - k r). A car is no rectangle in the road frame; `dynamics.roads.footprint` computes a
rectangle that contains it. A bicycle that follows the bend points inwards by its slip angle, asin(k / (1 - k r) L / 2).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from dynamics.roads.footprint import bend_growth
from dynamics.state import FloatArray

__all__ = ["Bends"]

_HEADINGS = np.linspace(-1.0, 1.0, 41)
"""Headings over which a footprint is bounded [rad]; beyond them, a car is across the road."""
_KINK = 0.1
"""Greatest angle between a lane of an inexact map and the path [rad] (racetrack-v0: 0.09)."""


@dataclass(frozen=True)
class Bends:
    """Bounds over the bends of a road.

    Parameters
    ----------
    least, greatest : curvature of its path [1/m].
    low, high : lateral positions of its edges [m].
    deviation : greatest distance of a lane of the map from the lane of the road [m].
    """

    least: float
    greatest: float
    low: float
    high: float
    deviation: float
    _grown: dict[tuple[float, float], tuple[float, float]] = field(default_factory=dict, repr=False, compare=False)

    def stretch(self, r: Any) -> tuple[FloatArray, FloatArray]:
        """Least and greatest metres of the path that one metre driven at lateral positions `r` [m] covers."""
        inside = np.minimum(np.maximum(r, self.low), self.high)
        both = np.stack([1 / (1 - k * inside) for k in (self.least, self.greatest)])
        return both.min(axis=0), both.max(axis=0)

    def growth(self, length: float, width: float) -> tuple[float, float]:
        """Extra half extents (along, across) [m] that a rectangle needs to contain a car anywhere on the road."""
        key = (float(length), float(width))
        if key not in self._grown:
            # The growth is greatest at the greatest curvature, and at an edge.
            psi, r, k = np.meshgrid(
                _HEADINGS, np.linspace(self.low, self.high, 9), [self.least, self.greatest], indexing="ij"
            )
            cos, sin = np.abs(np.cos(psi)), np.abs(np.sin(psi))
            extents = np.hypot(key[0] * cos + key[1] * sin, key[0] * sin + key[1] * cos)
            inside = k * r + np.abs(k) * extents / 2 < 1
            along, across = bend_growth(*key, psi[inside], r[inside], k[inside])
            self._grown[key] = float(along.max(initial=0.0)), float(across.max(initial=0.0)) + self.deviation
        return self._grown[key]

    @cached_property
    def tightest(self) -> float:
        """Greatest curvature of the path of a vehicle anywhere on the road [1/m]."""
        return max(abs(k) / (1 - k * r) for k in (self.least, self.greatest) for r in (self.low, self.high))

    def slip_angle(self, length: float) -> float:
        """Greatest angle to the path [rad] of a vehicle of a given length [m] that keeps its lane."""
        return float(np.arcsin(min(0.5 * length * self.tightest, 1.0))) + (_KINK if self.deviation > 0 else 0.0)
