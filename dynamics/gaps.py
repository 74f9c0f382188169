"""Gaps between the lanes of a map.

Where neighbouring lanes of a bend are not concentric, the edge of one need not reach the edge of the next: racetrack-v0
has a strip of 8 cm, 28 m long, in the middle of its road that belongs to no lane. highway-env looks at the vehicle's
centre alone (`Vehicle.on_road`), and one that is there is off the road.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.compiled import compiled
from dynamics.state import FloatArray

__all__ = ["Gaps"]

_STEP = 0.1
"""Spacing of the table [m]."""
_WIDER = 0.02
"""By how much a gap is taken to be wider on either side: which lane is the nearest depends on the heading too [m]."""


@compiled
def _meets(paths: Any, low: Any, high: Any, step: float, length: float) -> Any:
    """Whether any state of each path (n, K, 4) lies between `low` and `high` (places, m), (n,)."""
    out, places = np.zeros(paths.shape[0], np.bool_), low.shape[0]
    for i in range(paths.shape[0]):
        for k in range(paths.shape[1]):
            s, r = paths[i, k, 0], paths[i, k, 1]
            if not np.isfinite(s + r):
                continue
            if length > 0:
                s -= length * np.floor(s / length)
            if not 0 <= s < places * step:
                continue
            at = min(int(s / step), places - 1)
            for j in range(low.shape[1]):
                if low[at, j] < r < high[at, j]:
                    out[i] = True
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Gaps:
    """Strips along a road, between neighbouring lanes, that none of its map's lanes covers.

    Parameters
    ----------
    low, high : lateral extent of each strip on the stretches [i, i + 1] x `step` of the road, (stretches, lanes - 1)
        [m]; +inf and -inf where there is none.
    lap : length of a closed road [m], 0 of an open one.
    step : length of a stretch [m].
    """

    low: FloatArray
    high: FloatArray
    lap: float = 0.0
    step: float = _STEP

    @classmethod
    def of(cls, road: Any, sections: list[list[Any]]) -> Gaps | None:
        """The gaps between the lanes of a map, as its sections [their lanes] lie along the road; None without any."""
        stretches, strips = int(np.ceil(road.length / _STEP)), len(road.centers) - 1
        low, high = np.full((stretches, strips), np.inf), np.full((stretches, strips), -np.inf)
        for lanes in sections:
            for j, (below, above) in enumerate(itertools.pairwise(lanes)):
                s, top = _edge(road, below, 1.0)
                other, bottom = _edge(road, above, -1.0)
                at = np.arange(np.ceil(s[0] / _STEP), np.floor(s[-1] / _STEP) + 1)
                upper = np.interp(at * _STEP, s, top)
                # The lanes' own lengths differ by some metres: where both are.
                lower = np.interp(at * _STEP, other, bottom, left=-np.inf, right=-np.inf)
                open_ = lower > upper + 1e-9
                # A stretch more on either side, for the last one of a lap is shorter.
                for shift in (-2, -1, 0, 1):
                    rows = at[open_].astype(int) + shift
                    rows = rows % stretches if road.closed else rows.clip(0, stretches - 1)
                    low[rows, j] = np.minimum(low[rows, j], upper[open_] - _WIDER)
                    high[rows, j] = np.maximum(high[rows, j], lower[open_] + _WIDER)
        if not (low < high).any():
            return None
        return cls(low, high, road.length if road.closed else 0.0)

    def met(self, paths: FloatArray) -> Any:
        """Whether the centre is in a gap in any frame of each path (n, K, 4) of road states, (n,) bool."""
        return _meets(paths, self.low, self.high, self.step, self.lap)


def _edge(road: Any, lane: Any, side: float) -> tuple[FloatArray, FloatArray]:
    """Where an edge of a lane of the map is, as ascending arc lengths and lateral positions (k,), (k,) [m]."""
    t = np.linspace(0.0, lane.length, max(int(lane.length / _STEP), 1) + 1)
    points = np.array([lane.position(x, side * lane.width_at(x) / 2) for x in t])
    states = np.column_stack([points, np.zeros((len(t), 2))])
    first = float(road.to_road(states[len(t) // 2])[0])
    return tuple(road.to_road(states, near=first)[:, :2].T)
