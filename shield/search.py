"""The search for the input nearest to a proposal among those that verify.

What verifies is decided by a judge, and nothing leaves that was not judged. The margin is the least of several parts
(a vehicle each, the lane that is stopped in, the road's edges), and each of them is nearly linear in the input of one
frame. So the search

1. linearises all parts at an input by finite differences of the exact rollouts, goes to the nearest point at which they
   hold (`mpc.nearest`), and again from there: Newton's method for the nearest point of the boundary. Since the set of
   what verifies is not convex, a ring of inputs around the proposal is judged along the way;
2. where that has found nothing: tries a fan of inputs between the proposal and braking in a lane, and then
   rings around the proposal, nearer than the best so far.

Distances are in shares of the actuators' ranges.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.state import FloatArray
from mpc.nearest import nearest
from shield.verify import Clearance, least_bad

__all__ = ["Judged", "Search"]

_LINEARISATIONS = 5
_STEP = 2e-3
"""Step of the finite differences, as a share of the ranges."""
_INSIDE = 0.003
"""How far inside of the boundary to aim [m]."""
_SETTLED = 5e-3
"""Change below which nothing nearer is looked for, as a share of the ranges."""
_RING = 0.8 * np.stack([f(np.linspace(-np.pi, np.pi, 13)[1:]) for f in (np.cos, np.sin)], axis=1)
_FAN = np.array([(i, j) for j in (0.0, 0.25, 0.5, 0.75, 1.0) for i in (0.0, 0.25, 0.5, 0.75, 0.9, 1.0)][1:])
"""Shares of the way from the proposal to braking in a lane: (acceleration, steering)."""


def _rings(count: int, angles: FloatArray) -> FloatArray:
    taken, angle = (x.reshape(-1) for x in np.meshgrid(np.arange(1, count) / count, angles, indexing="ij"))
    return np.stack([taken, angle], axis=1)


_NEARER = (
    (4, _rings(4, np.linspace(-np.pi, np.pi, 17)[1:])),
    (5, _rings(5, np.linspace(-0.4, 0.4, 11))),
    (5, _rings(5, np.linspace(-0.12, 0.12, 11))),
)
"""Where nearer inputs are looked for, seen from the proposal: shares of a step that are taken off the distance of the
best so far, and angles [rad] from it. The first step is the distance itself, the next ones what lies between two rings
of the last. First all around, for what verifies need not be on the way to the best."""
_NEAR = 0.01
"""Step below which no nearer input is looked for, as a share of the ranges."""


@dataclass(frozen=True, slots=True)
class Judged:
    """Inputs (n, 2), and the best fail-safe of each: margin [m], frames that stay clear and on the road, lane, path;
    and what the margin is made of (n, parts) [m], where it was asked for."""

    inputs: FloatArray
    margin: FloatArray
    clear: Any
    lanes: Any
    paths: FloatArray
    parts: FloatArray | None = None

    def row(self, i: int) -> Judged:
        """One of them."""
        one = slice(i, i + 1)
        return Judged(self.inputs[one], self.margin[one], self.clear[one], self.lanes[one], self.paths[one])


Judge = Callable[[FloatArray, list[int], bool], Judged]
"""Judges inputs (n, 2) for stops in the first of some lanes that verifies; with parts or without."""


class Search:
    """Looks for the nearest input to one proposal.

    Parameters
    ----------
    judge : decides what verifies.
    proposal : (2,).
    spans : ranges of the actuators, (2,); zero where there is none.
    least, most : bounds of the inputs, (2,).
    """

    def __init__(
        self, judge: Judge, proposal: FloatArray, spans: FloatArray, least: FloatArray, most: FloatArray
    ) -> None:
        self._judge, self._proposal, self._least, self._most = judge, proposal, least, most
        self._spans = np.where(spans > 0, spans, 1.0)
        self._low, self._high = (least - proposal) / self._spans, (most - proposal) / self._spans

    def run(self, lanes: list[int], law: FloatArray) -> Judged:
        """The nearest input that was found; if none verifies, the least bad one.

        Parameters
        ----------
        lanes : to stop in, in order of preference.
        law : inputs of braking in the first of them, (2,).
        """
        best: Judged | None = None
        for lane in lanes:
            best = self._linearise(lane, best)
        return best if best is not None else self._scan(lanes, law)

    def _linearise(self, lane: int, best: Judged | None) -> Judged | None:
        """What is nearer than the best so far, among the inputs with a stop in that lane; else the best so far."""
        z = np.clip(np.zeros(2), self._low, self._high)
        reach = np.inf if best is None else float(self._distance(best.inputs)[0])
        restarted = False
        for k in range(_LINEARISATIONS):
            sign = np.where(z + _STEP > self._high, -1.0, 1.0)
            points = np.vstack([z, z + _STEP * np.diag(sign)])
            if k:
                around = min(float(np.hypot(*z)), reach) * _RING
                points = np.vstack([points, np.clip(around, self._low, self._high)])
            judged = self._judge(self._proposal + self._spans * points, [lane], True)
            distance = np.where(judged.margin >= 0, np.hypot(*points.T), np.inf)
            i = int(distance.argmin())
            if distance[i] < reach:
                best, reach = judged.row(i), float(distance[i])
                if i > 2 and not restarted:
                    z, restarted = points[i], True
                    continue
            assert judged.parts is not None
            parts = judged.parts[:3]
            parts = parts[:, np.isfinite(parts).all(axis=0)]
            slopes = ((parts[1:] - parts[0]) / (_STEP * sign[:, None])).T
            goal = nearest(parts[0] - _INSIDE, slopes, z, self._low, self._high)
            if goal is None:
                break
            # What is as near as the best, or not far from here, brings nothing more.
            if best is not None and (np.abs(goal - z).max() < _SETTLED or np.hypot(*goal) > reach - _SETTLED):
                break
            z = goal
        return best

    def _scan(self, lanes: list[int], law: FloatArray) -> Judged:
        judged = self._judge(self._box(self._proposal + _FAN * (law - self._proposal)), lanes, False)
        if not (judged.margin >= 0).any():
            return judged.row(least_bad(Clearance(judged.margin, judged.clear)))
        best = judged.row(self._nearest(judged))
        step = float(self._distance(best.inputs)[0])
        for count, rings in _NEARER:
            if not step > _NEAR:
                break
            judged = self._judge(self._nearer(best.inputs[0], step, rings), [int(best.lanes[0])], False)
            if (judged.margin >= 0).any():
                nearer = judged.row(self._nearest(judged))
                best = min((nearer, best), key=lambda x: self._distance(x.inputs)[0])
            step /= count
        return best

    def _nearest(self, judged: Judged) -> int:
        return int(np.where(judged.margin >= 0, self._distance(judged.inputs), np.inf).argmin())

    def _nearer(self, inputs: FloatArray, step: float, rings: FloatArray) -> FloatArray:
        """Inputs (n, 2) on `rings` around the proposal, up to `step` nearer to it than `inputs` (2,)."""
        a, delta = (inputs - self._proposal) / self._spans
        radius = np.maximum(np.hypot(a, delta) - step * rings[:, 0], 0.0)
        angle = np.arctan2(delta, a) + rings[:, 1]
        around = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
        return self._box(self._proposal + self._spans * around)

    def _box(self, inputs: FloatArray) -> FloatArray:
        return np.clip(inputs, self._least, self._most)

    def _distance(self, inputs: FloatArray) -> FloatArray:
        return np.asarray(np.hypot(*((inputs - self._proposal) / self._spans).T))
