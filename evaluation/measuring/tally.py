"""Tallies of episodes of the compiled highway, decision by decision, for a batch."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.traffic.rules_of_the_road import RoadRule
from shield.batch.arrays import BatchRecords
from shield.batch.codes import FALLBACKS, OVERRIDES

__all__ = ["HORIZON", "SOON", "Tallies", "begin_tally", "distance", "empty_tallies", "tally", "time_to_collision"]

HORIZON = 10.0
"""Largest time to a collision; later collisions do not count [s]."""
SOON = 1e-3
"""Least time to a collision that has not happened [s]."""


class Tallies(NamedTuple):
    """Sums over the present episode of each environment, (e,); the names are those of `EpisodeRecord`.

    Attributes
    ----------
    held_back : number of decisions in `overridden` with the proposal as the action.
    min_ttc : least time to a collision at constant velocities, at most `HORIZON`, and 0 in a crash [s].
    speeds : sum of the ego's speed over `counted` frames, up to a crash [m/s].
    fallbacks : number of decisions with a fallback.
    broken : sums of `BatchRecords.broken`, (e, rules).
    """

    total: FloatArray
    steps: IntArray
    speeds: FloatArray
    counted: IntArray
    overridden: IntArray
    held_back: IntArray
    frames: IntArray
    frames_overridden: IntArray
    violations: IntArray
    min_margin: FloatArray
    min_gap: FloatArray
    min_ttc: FloatArray
    crashed: BoolArray
    off_road: BoolArray
    fallbacks: IntArray
    broken: IntArray


def empty_tallies(e: int) -> Tallies:
    """Tallies of zeros for e environments."""
    kinds: list[Any] = [float, int, float, int, int, int, int, int, int, float, float, float, bool, bool, int]
    rows: list[Any] = [*(np.zeros(e, kind) for kind in kinds), np.zeros((e, len(RoadRule)), int)]
    return Tallies(*rows)


@kernel_inline
def _to_corners(a: FloatArray, b: FloatArray) -> float:
    """Least distance between rectangle `b` and a corner of `a` [m]."""
    cos_a, sin_a, cos_b, sin_b = math.cos(a[2]), math.sin(a[2]), math.cos(b[2]), math.sin(b[2])
    least = np.inf
    for i in (-0.5, 0.5):
        for j in (-0.5, 0.5):
            along, across = i * a[4], j * a[5]
            x, y = a[0] + cos_a * along - sin_a * across - b[0], a[1] + sin_a * along + cos_a * across - b[1]
            dx = max(abs(cos_b * x + sin_b * y) - 0.5 * b[4], 0.0)
            dy = max(abs(cos_b * y - sin_b * x) - 0.5 * b[5], 0.0)
            least = min(least, math.hypot(dx, dy))
    return least


@kernel_no_refcount
def distance(a: FloatArray, b: FloatArray) -> float:
    """Distance between two vehicle rows (7,) [m], 0 if they overlap.

    Two rectangles that do not overlap are nearest at a corner of one of them.
    """
    x, y = a[0] - b[0], a[1] - b[1]
    cos, sin = math.cos(a[2] - b[2]), math.sin(a[2] - b[2])
    c, s = abs(cos), abs(sin)
    gap = -np.inf
    for one, other in ((a, b), (b, a)):
        ux, uy = math.cos(one[2]), math.sin(one[2])
        gap = max(gap, abs(x * ux + y * uy) - 0.5 * (one[4] + other[4] * c + other[5] * s))
        gap = max(gap, abs(y * ux - x * uy) - 0.5 * (one[5] + other[4] * s + other[5] * c))
    return 0.0 if gap <= 0 else min(_to_corners(a, b), _to_corners(b, a))


@kernel_inline
def _while_near(offset: float, speed: float, half: float) -> tuple[float, float]:
    """Start and end of the overlap of two intervals, with centres `offset` apart that separate at `speed`."""
    if abs(speed) < 1e-9:
        return (-np.inf, np.inf) if abs(offset) < half else (np.inf, -np.inf)
    a, b = (-half - offset) / speed, (half - offset) / speed
    return (a, b) if a < b else (b, a)


@kernel_no_refcount
def time_to_collision(a: FloatArray, b: FloatArray) -> float:
    """Time until two vehicle rows (7,) overlap at constant velocities, at most `HORIZON` [s].

    Each vehicle is the upright rectangle around it.
    """
    least, most = 0.0, HORIZON
    for axis in range(2):
        half, speed = 0.0, 0.0
        for row, sign in ((a, -1.0), (b, 1.0)):
            along, across = math.cos(row[2]), math.sin(row[2])
            if axis == 1:
                along, across = across, along
            half += 0.5 * (row[4] * abs(along) + row[5] * abs(across))
            speed += sign * row[3] * along
        begin, end = _while_near(b[axis] - a[axis], speed, half)
        least, most = max(least, begin), min(most, end)
    return least if least < most else HORIZON


@kernel_no_refcount
def _see(rows: FloatArray, off_road: bool, tallies: Tallies, e: int, times: bool) -> None:
    """Add one frame, with bodies (m, 7), the ego first; see `tally`."""
    tallies.off_road[e] = tallies.off_road[e] or off_road
    if tallies.crashed[e]:
        return
    ego = rows[0]
    tallies.speeds[e] += ego[3]
    tallies.counted[e] += 1
    if ego[6] > 0:
        tallies.crashed[e], tallies.min_gap[e], tallies.min_ttc[e] = True, 0.0, 0.0
        return
    for i in range(1, rows.shape[0]):
        # The distance of the bodies is at least that of their circumscribed circles.
        reach = 0.5 * (math.hypot(ego[4], ego[5]) + math.hypot(rows[i, 4], rows[i, 5]))
        if math.hypot(rows[i, 0] - ego[0], rows[i, 1] - ego[1]) - reach < tallies.min_gap[e]:
            tallies.min_gap[e] = min(tallies.min_gap[e], distance(ego, rows[i]))
        if times:
            tallies.min_ttc[e] = min(tallies.min_ttc[e], time_to_collision(ego, rows[i]))


@kernel_no_refcount
def begin_tally(tallies: Tallies, e: int, rows: FloatArray, off_road: bool, times: bool) -> None:
    """Reset the tallies of environment `e` and add the scene after its reset; see `tally`."""
    tallies.total[e] = tallies.speeds[e] = 0.0
    tallies.steps[e] = tallies.counted[e] = tallies.overridden[e] = tallies.frames[e] = 0
    tallies.held_back[e] = 0
    tallies.frames_overridden[e] = tallies.violations[e] = tallies.fallbacks[e] = 0
    for k in range(tallies.broken.shape[1]):
        tallies.broken[e, k] = 0
    tallies.min_margin[e], tallies.min_gap[e], tallies.min_ttc[e] = np.nan, np.inf, HORIZON
    tallies.crashed[e] = tallies.off_road[e] = False
    _see(rows, off_road, tallies, e, times)


@kernel_no_refcount
def tally(
    tallies: Tallies,
    records: BatchRecords,
    rows: FloatArray,
    off_road: BoolArray,
    reward: FloatArray,
    going: BoolArray,
    times: bool,
) -> None:
    """Add one decision of each environment that is `going`, (e,).

    Parameters
    ----------
    tallies : the tallies, changed in place.
    records, rows, off_road : see `ShieldedHighways`.
    reward : rewards, (e,).
    going : environments to count, (e,).
    times : whether `Tallies.min_ttc` is computed; it stays `HORIZON` otherwise.
    """
    for e in range(rows.shape[0]):
        if not going[e]:
            continue
        tallies.total[e] += reward[e]
        tallies.steps[e] += 1
        tallies.violations[e] += records.violations[e]
        for k in range(tallies.broken.shape[1]):
            tallies.broken[e, k] += records.broken[e, k]
        overridden_frames, fell = 0, FALLBACKS[records.tier[e]]
        margin = tallies.min_margin[e]
        if math.isfinite(records.margin[e]) and not margin <= records.margin[e]:
            margin = records.margin[e]
        for k in range(rows.shape[1]):
            if OVERRIDES[records.tiers[e, k]]:
                overridden_frames += 1
                fell = fell or FALLBACKS[records.tiers[e, k]]
            if math.isfinite(records.margins[e, k]) and not margin <= records.margins[e, k]:
                margin = records.margins[e, k]
            _see(rows[e, k], off_road[e, k], tallies, e, times)
        tallies.min_margin[e] = margin
        tallies.frames[e] += rows.shape[1]
        tallies.frames_overridden[e] += overridden_frames
        # As in `Decision.with_frames`: a fallback equal to the proposal is no override.
        other = OVERRIDES[records.tier[e]] and records.executed[e] != records.proposed[e]
        tallies.overridden[e] += other or overridden_frames > 0
        tallies.held_back[e] += overridden_frames > 0 and not other
        tallies.fallbacks[e] += fell
