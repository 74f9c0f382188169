"""Search for the verified input nearest to a proposal.

A judge decides which inputs verify, and only judged inputs are returned. The margin is the least of several parts (one
for each vehicle, the lane of the stop, the edges of the road). Each part is nearly linear in the input of one frame. So
the search

1. linearises all parts at an input, by finite differences of the exact rollouts. It goes to the nearest point at which
they are satisfied (`mpc.filter.solvers.nearest_point`), and repeats this from there: Newton's method for the nearest
point of the boundary;
2. if this finds none: tries a fan of inputs between the proposal and braking in a lane, and then rings around the
proposal, nearer than the best so far;
3. sweeps the region nearer than the best so far with evenly spread points, since the set of verified inputs is neither
convex nor always connected. If none of the points verifies, it continues from the best two as in step 1. From an input
that is found, step 1 is repeated, followed by one more sweep.

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

__all__ = ["JudgedInputs", "NearestInputSearch"]

_LINEARISATIONS = 4
"""Greatest number of linearisations from one starting point."""
_STEP = 2e-3
"""Step of the finite differences, as a share of the ranges."""
_INSIDE = 0.003
"""Distance from the boundary to the interior point that is aimed at [m]."""
_SETTLED = 5e-3
"""Change below which the search for a nearer input ends, as a share of the ranges."""
_FAN = np.array([(i, j) for j in (0.0, 0.25, 0.5, 0.75, 1.0) for i in (0.0, 0.25, 0.5, 0.75, 0.9, 1.0)][1:])
"""Shares of the distance from the proposal to braking in a lane: (acceleration, steering)."""


def _rings(count: int, angles: FloatArray) -> FloatArray:
    """Points of `_NEARER`: (share of a step, angle [rad]), for `count` - 1 shares and each angle."""
    taken, angle = (x.reshape(-1) for x in np.meshgrid(np.arange(1, count) / count, angles, indexing="ij"))
    return np.stack([taken, angle], axis=1)


_NEARER = (
    (4, _rings(4, np.linspace(-np.pi, np.pi, 17)[1:])),
    (5, _rings(5, np.linspace(-0.4, 0.4, 11))),
    (5, _rings(5, np.linspace(-0.12, 0.12, 11))),
)
"""Places of nearer inputs, as seen from the proposal: shares of a step by which the distance of the best so far is
reduced, and angles from it [rad]. The first step is the distance itself; each further step is the distance between two
rings of the last. The first rings cover all directions, since verified inputs need not lie on the way to the best."""
_NEAR = 0.01
"""Step below which the search for a nearer input ends, as a share of the ranges."""


_SWEEPS = 2
"""Greatest number of sweeps."""
_STREWN = 48
"""Greatest number of points of a sweep."""
_SPACING = 0.02
"""Least spacing of these points, as a share of the ranges."""
_APART = 0.15
"""Least distance between the two points from which a failed sweep continues, as a share of the ranges."""


def _spiral(count: int) -> FloatArray:
    """Points spread over a disc, one for each unit of area, (count, 2): Vogel's spiral."""
    i = np.arange(count) + 0.5
    radius, angle = np.sqrt(i / np.pi), i * (np.pi * (3.0 - np.sqrt(5.0)))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


_SPIRAL = _spiral(4 * _STREWN)


@dataclass(frozen=True, slots=True)
class JudgedInputs:
    """Judged inputs.

    Attributes
    ----------
    inputs : acceleration [m/s^2] and front wheel angle [rad], (n, 2).
    margin : margin of the best fail-safe of each, (n,) [m]. clear : number of frames that stay clear and on the road,
        (n,).
    lanes, paths : lane and path of the fail-safe.
    parts : parts of the margin, (n, parts) [m], if requested.
    bind : returns the binding clause and vehicle of an input.
    """

    inputs: FloatArray
    margin: FloatArray
    clear: Any
    lanes: Any
    paths: FloatArray
    parts: FloatArray | None = None
    bind: Callable[[int], Binding] = field(default=lambda _: NOTHING, repr=False)

    def row(self, i: int) -> JudgedInputs:
        """The result for input `i` alone."""
        one = slice(i, i + 1)
        bind = self.bind
        rows = self.inputs[one], self.margin[one], self.clear[one], self.lanes[one], self.paths[one]
        return JudgedInputs(*rows, bind=lambda _: bind(i))


Evaluate = Callable[[FloatArray, list[int], bool], JudgedInputs]
"""Judges inputs (n, 2), each for a stop in the first of some lanes for which it verifies; the flag requests the parts
of the margin."""


class NearestInputSearch:
    """Searches for the verified input nearest to one proposal.

    Parameters
    ----------
    judge : judges inputs.
    proposal : (2,). spans : ranges of the actuators, (2,); 0 where there is none.
    least, most : bounds of the inputs, (2,).
    """

    def __init__(
        self, judge: Evaluate, proposal: FloatArray, spans: FloatArray, least: FloatArray, most: FloatArray
    ) -> None:
        self._judge, self._proposal, self._least, self._most = judge, proposal, least, most
        self._spans = np.where(spans > 0, spans, 1.0)
        self._low, self._high = (least - proposal) / self._spans, (most - proposal) / self._spans

    def run(self, lanes: list[int], fail_safe_inputs: FloatArray, every: list[int] | None = None) -> JudgedInputs:
        """The nearest verified input that was found; if none verifies, the least bad one.

        Parameters
        ----------
        lanes : lanes to stop in, in order of preference.
        fail_safe_inputs : inputs of braking in the first of them, (2,).
        every : all lanes that a sweep may stop in; `lanes` by default.
        """
        best: JudgedInputs | None = None
        for lane in lanes:
            best = self._linearise(lane, best)
        if best is None:
            best = self._scan(lanes, fail_safe_inputs)
            if not best.margin[0] >= 0:
                return best
        for _ in range(_SWEEPS):
            found = self._sweep(every or lanes, best)
            if found is None:
                break
            best = self._linearise(int(found.lanes[0]), found, (found.inputs[0] - self._proposal) / self._spans)
            assert best is not None
        return best

    def _sweep(self, lanes: list[int], best: JudgedInputs) -> JudgedInputs | None:
        """The nearest verified input among evenly spread points nearer than the best so far; None if none verifies."""
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

    def _climb(self, points: FloatArray, judged: JudgedInputs, reach: float) -> tuple[list[FloatArray], int]:
        """Points at which the linearised parts would be satisfied, starting from the best two of some points that do
        not verify; and the lane of the stop."""
        margin = np.nan_to_num(judged.margin, nan=-np.inf)
        first = int(margin.argmax())
        lane = judged.lanes[first]
        apart = (np.hypot(*(points - points[first]).T) > _APART) & (judged.lanes == lane)
        second = int(np.where(apart, margin, -np.inf).argmax())
        _, goals = self._goals(points[[first, second]], int(lane))
        return [goal for goal in goals if goal is not None and np.hypot(*goal) < reach], int(lane)

    def _goals(self, points: FloatArray, lane: int) -> tuple[JudgedInputs, list[FloatArray | None]]:
        """Judge points (n, 2) and their neighbours in both directions, (3 n,). For each point, the nearest point to the
        proposal at which the linearised parts of the margin are satisfied, or None."""
        n = len(points)
        step = np.where(points + _STEP > self._high, -_STEP, _STEP)
        perturbed = np.concatenate([points, points + step * [1.0, 0.0], points + step * [0.0, 1.0]])
        judged = self._judge(self._proposal + self._spans * perturbed, [lane], True)
        assert judged.parts is not None
        each, goals = judged.parts.reshape(3, n, -1), []
        for k in range(n):
            parts = each[:, k, np.isfinite(each[:, k]).all(axis=0)]
            slopes = ((parts[1:] - parts[0]) / step[k][:, None]).T
            goals.append(nearest(parts[0] - _INSIDE, slopes, points[k], self._low, self._high))
        return judged, goals

    def _strewn(self, reach: float) -> FloatArray:
        """Evenly spread points (n, 2) within the bounds and nearer than `reach`, in shares of the ranges from the
        proposal."""
        count = min(int(np.pi * (reach / _SPACING) ** 2), len(_SPIRAL))
        while True:
            points = _SPIRAL[:count] * (reach * np.sqrt(np.pi / max(count, 1)))
            points = points[((points >= self._low) & (points <= self._high)).all(axis=1)]
            if len(points) <= _STREWN:
                found: FloatArray = points
                return found
            count = count * _STREWN // len(points)

    def _linearise(self, lane: int, best: JudgedInputs | None, start: FloatArray | None = None) -> JudgedInputs | None:
        """The nearest verified input with a stop in that lane, if it is nearer than the best so far; otherwise the best
        so far. The search starts at the proposal, or at `start` (2,), in shares of the ranges."""
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
            # A goal no nearer than the best, or close to this point, brings no improvement.
            if best is not None and (np.abs(goal - z).max() < _SETTLED or np.hypot(*goal) > reach - _SETTLED):
                break
            z = goal
        return best

    def _scan(self, lanes: list[int], fail_safe_inputs: FloatArray) -> JudgedInputs:
        """The best of a fan of inputs and of rings around the proposal."""
        judged = self._judge(self._box(self._proposal + _FAN * (fail_safe_inputs - self._proposal)), lanes, False)
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

    def _nearest(self, judged: JudgedInputs) -> int:
        """Index of the nearest verified input."""
        return int(np.where(judged.margin >= 0, self._distance(judged.inputs), np.inf).argmin())

    def _nearer(self, inputs: FloatArray, step: float, rings: FloatArray) -> FloatArray:
        """Inputs (n, 2) on `rings` around the proposal, up to `step` nearer to it than `inputs` (2,)."""
        a, delta = (inputs - self._proposal) / self._spans
        radius = np.maximum(np.hypot(a, delta) - step * rings[:, 0], 0.0)
        angle = np.arctan2(delta, a) + rings[:, 1]
        around = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
        return self._box(self._proposal + self._spans * around)

    def _box(self, inputs: FloatArray) -> FloatArray:
        """Inputs clipped to the actuators' ranges."""
        return np.clip(inputs, self._least, self._most)

    def _distance(self, inputs: FloatArray) -> FloatArray:
        """Distance from the proposal, in shares of the ranges."""
        return np.asarray(np.hypot(*((inputs - self._proposal) / self._spans).T))
