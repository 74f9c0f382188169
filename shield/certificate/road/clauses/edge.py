"""Clauses of the road: the body stays on the road and enters at most one lane, and a plan does not begin backwards."""

from __future__ import annotations

import math

import numpy as np

from dynamics.compiled import compiled
from dynamics.state import BoolArray, FloatArray, IntArray
from shield.certificate.road.clauses.others import TOUCH

__all__ = ["lanes_touched", "verdicts"]


@compiled
def _half_extent(body: tuple[float, float, float], heading: float) -> float:
    """Half of the body's extent across the road at a heading [rad], with its growth on a curve [m]."""
    length, width, growth = body
    return 0.5 * (length * abs(math.sin(heading)) + width * abs(math.cos(heading))) + growth


@compiled
def _count_entered(entering: BoolArray, fails: IntArray, entered: IntArray, i: int) -> int:
    """Number of lanes that path i enters besides the lane that it stops in; the first of them is written to
    `entered`."""
    count = 0
    for j in range(entering.shape[0] - 1, -1, -1):
        if entering[j] and j != fails[i]:
            entered[i] = j
            count += 1
    return count


@compiled
def lanes_touched(
    state: FloatArray,
    paths: FloatArray,
    body: tuple[float, float, float],
    centers: FloatArray,
    side: float,
    owned: BoolArray,
    fails: IntArray,
) -> tuple[IntArray, FloatArray, BoolArray, IntArray]:
    """Lanes that the body touches on each path.

    Parameters
    ----------
    state, paths : road states of the ego now, (4,), and after each frame, (n, K, 4).
    body : its length, its width, and its lateral growth on a curve [m].
    centers, side : of the lanes, and half their width [m]. owned : lanes that the ego owns, (lanes,) bool.
    fails : lane that each path stops in, (n,).

    Returns
    -------
    entered : lane that the path enters besides the owned ones and the last, (n,); the last lane if there is none. An
        owned lane counts if the path comes back to it.
    edges : room to the edges of the road, (n, 2) [m].
    allowed : whether the path enters at most one lane, (n,) bool.
    on_road : number of frames before it leaves the road, (n,).
    """
    n, frames, lanes = paths.shape[0], paths.shape[1], centers.shape[0]
    entered, allowed, on_road = fails.copy(), np.ones(n, np.bool_), np.full(n, frames)
    edges = np.empty((n, 2))
    first, last = centers[0] - side, centers[lanes - 1] + side
    within, beside, entering = np.empty(lanes, np.bool_), np.empty(lanes, np.bool_), np.empty(lanes, np.bool_)
    for i in range(n):
        half = _half_extent(body, state[2])
        for j in range(lanes):
            offset = abs(state[1] - centers[j])
            within[j], beside[j], entering[j] = offset < TOUCH + half, offset < side + half, False
        least, most = np.inf, -np.inf
        for k in range(frames):
            r, half = paths[i, k, 1], _half_extent(body, paths[i, k, 2])
            if not math.isfinite(r + half):
                least, most, allowed[i], on_road[i] = np.nan, np.nan, False, 0
                break
            low, high = r - half, r + half
            least, most = min(least, low), max(most, high)
            if (low < first or high > last) and k < on_road[i]:
                on_road[i] = k
            for j in range(lanes):
                inside = low < centers[j] + TOUCH and high > centers[j] - TOUCH
                touches = low < centers[j] + side and high > centers[j] - side
                # No vehicle keeps a place free in a lane that the ego has left.
                if (touches and not (owned[j] and beside[j])) or (inside and not within[j]):
                    entering[j] = True
                within[j], beside[j] = inside, touches
        edges[i, 0], edges[i, 1] = least - first, last - most
        if _count_entered(entering, fails, entered, i) > 1:
            allowed[i] = False
    return entered, edges, allowed, on_road


@compiled
def verdicts(
    margin: FloatArray, edges: FloatArray, allowed: BoolArray, paths: FloatArray, input_frames: int
) -> FloatArray:
    """Reduce margins (n,) by the room that each path lacks at the edges of the road, (n, 2) [m].

    The result is -inf for a path that is not allowed, or that moves backwards after `in_owned_lane` frames: such a
    path has no fail-safe, since the brake only stops forward motion.
    """
    out = np.empty(margin.shape[0])
    for i in range(margin.shape[0]):
        edge_margin = min(edges[i, 0], edges[i, 1])
        if not allowed[i] or paths[i, input_frames - 1, 3] < -1e-9:
            out[i] = -np.inf
        elif math.isnan(edges[i, 0] + edges[i, 1]) or math.isnan(margin[i]):
            out[i] = np.nan
        else:
            out[i] = margin[i] if edge_margin >= 0 else min(margin[i], edge_margin)
    return out
