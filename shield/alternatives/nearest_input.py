"""The search for the input nearest to a proposal among those that verify.

What verifies is decided by a judge, and nothing leaves that was not judged. The margin is the least of several parts
(a vehicle each, the lane that is stopped in, the road's edges), and each of them is nearly linear in the input of one
frame. So the search

1. linearises all parts at an input by finite differences of the exact rollouts, goes to the nearest point at which they
   hold (`mpc.filter.solvers.nearest_point`), and again from there: Newton's method for the boundary's nearest point;
2. where that has found nothing: tries a fan of inputs between the proposal and braking in a lane, and then
   rings around the proposal, nearer than the best so far;
3. sweeps what is nearer than the best so far with points strewn evenly, for what verifies is not convex and need not
   be in one piece. Where none of them verifies, it goes on from the two best of them as in step 1; from what is found
   step 1 is repeated, and the rest is swept once more.

Distances are in shares of the actuators' ranges.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dynamics.state import FloatArray
from mpc.filter.solvers.nearest_point import nearest
from shield.certificate.road.verify import NOTHING, Binding, Clearance, least_bad

__all__ = ["Judged", "Search"]

_LINEARISATIONS = 4
_STEP = 2e-3
"""Step of the finite differences, as a share of the ranges."""
_INSIDE = 0.003
"""How far inside of the boundary to aim [m]."""
_SETTLED = 5e-3
"""Change below which nothing nearer is looked for, as a share of the ranges."""
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


_SWEEPS = 2
_STREWN = 48
"""Points of a sweep, at most."""
_SPACING = 0.02
"""And their least spacing, as a share of the ranges."""
_APART = 0.15
"""Least distance between two points that are climbed from, as a share of the ranges."""


def _spiral(count: int) -> FloatArray:
    """Points strewn over a disc, one for each unit of area, (count, 2): Vogel's spiral."""
    i = np.arange(count) + 0.5
    radius, angle = np.sqrt(i / np.pi), i * (np.pi * (3.0 - np.sqrt(5.0)))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


_SPIRAL = _spiral(4 * _STREWN)


@dataclass(frozen=True, slots=True)
class Judged:
    """Inputs (n, 2), and the best fail-safe of each: margin [m], frames that stay clear and on the road, lane, path;
    what the margin is made of (n, parts) [m], where it was asked for; and what tells where one comes from."""

    inputs: FloatArray
    margin: FloatArray
    clear: Any
    lanes: Any
    paths: FloatArray
    parts: FloatArray | None = None
    bind: Callable[[int], Binding] = field(default=lambda _: NOTHING, repr=False)

    def row(self, i: int) -> Judged:
        """One of them."""
        one = slice(i, i + 1)
        bind = self.bind
        rows = self.inputs[one], self.margin[one], self.clear[one], self.lanes[one], self.paths[one]
        return Judged(*rows, bind=lambda _: bind(i))


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

    def run(self, lanes: list[int], law: FloatArray, every: list[int] | None = None) -> Judged:
        """The nearest input that was found; if none verifies, the least bad one.

        Parameters
        ----------
        lanes : to stop in, in order of preference.
        law : inputs of braking in the first of them, (2,).
        every : all lanes that a sweep may stop in; `lanes` by default.
        """
        best: Judged | None = None
        for lane in lanes:
            best = self._linearise(lane, best)
        if best is None:
            best = self._scan(lanes, law)
            if not best.margin[0] >= 0:
                return best
        for _ in range(_SWEEPS):
            found = self._sweep(every or lanes, best)
            if found is None:
                break
            best = self._linearise(int(found.lanes[0]), found, (found.inputs[0] - self._proposal) / self._spans)
            assert best is not None
        return best

    def _sweep(self, lanes: list[int], best: Judged) -> Judged | None:
        """The nearest of points strewn evenly over what is nearer than the best so far; None where none verifies."""
        reach = float(self._distance(best.inputs)[0]) - _SETTLED
        if reach <= 0:
            return None
        points = self._strewn(reach)
        if not len(points):
            return None
        judged = self._judge(self._proposal + self._spans * points, lanes, False)
        if (judged.margin >= 0).any():
            return judged.row(self._nearest(judged))
        goals, lane = self._climb(points, judged, reach)
        if not goals:
            return None
        judged = self._judge(self._proposal + self._spans * np.array(goals), [lane], False)
        return judged.row(self._nearest(judged)) if (judged.margin >= 0).any() else None

    def _climb(self, points: FloatArray, judged: Judged, reach: float) -> tuple[list[FloatArray], int]:
        """Where the linearised parts would hold, seen from the two best of some points that do not verify; and the
        lane to stop in."""
        margin = np.nan_to_num(judged.margin, nan=-np.inf)
        first = int(margin.argmax())
        lane = judged.lanes[first]
        apart = (np.hypot(*(points - points[first]).T) > _APART) & (judged.lanes == lane)
        second = int(np.where(apart, margin, -np.inf).argmax())
        _, goals = self._goals(points[[first, second]], int(lane))
        return [goal for goal in goals if goal is not None and np.hypot(*goal) < reach], int(lane)

    def _goals(self, points: FloatArray, lane: int) -> tuple[Judged, list[FloatArray | None]]:
        """Points (n, 2), and their neighbours in both directions, judged, (3 n,); and for each the nearest point to the
        proposal at which the parts of the margin, linearised there, hold, or None."""
        n = len(points)
        step = np.where(points + _STEP > self._high, -_STEP, _STEP)
        trial = np.concatenate([points, points + step * [1.0, 0.0], points + step * [0.0, 1.0]])
        judged = self._judge(self._proposal + self._spans * trial, [lane], True)
        assert judged.parts is not None
        each, goals = judged.parts.reshape(3, n, -1), []
        for k in range(n):
            parts = each[:, k, np.isfinite(each[:, k]).all(axis=0)]
            slopes = ((parts[1:] - parts[0]) / step[k][:, None]).T
            goals.append(nearest(parts[0] - _INSIDE, slopes, points[k], self._low, self._high))
        return judged, goals

    def _strewn(self, reach: float) -> FloatArray:
        """Points (n, 2) within the bounds and nearer than `reach`, in shares of the ranges from the proposal."""
        count = min(int(np.pi * (reach / _SPACING) ** 2), len(_SPIRAL))
        while True:
            points = _SPIRAL[:count] * (reach * np.sqrt(np.pi / max(count, 1)))
            points = points[((points >= self._low) & (points <= self._high)).all(axis=1)]
            if len(points) <= _STREWN:
                found: FloatArray = points
                return found
            count = count * _STREWN // len(points)

    def _linearise(self, lane: int, best: Judged | None, start: FloatArray | None = None) -> Judged | None:
        """What is nearer than the best so far, among the inputs with a stop in that lane; else the best so far. From
        the proposal, or from `start` (2,), in shares of the ranges."""
        z = np.clip(np.zeros(2) if start is None else start, self._low, self._high)
        reach = np.inf if best is None else float(self._distance(best.inputs)[0])
        for _ in range(_LINEARISATIONS):
            judged, (goal,) = self._goals(z[None], lane)
            distance = np.where(judged.margin >= 0, self._distance(judged.inputs), np.inf)
            i = int(distance.argmin())
            if distance[i] < reach:
                best, reach = judged.row(i), float(distance[i])
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
