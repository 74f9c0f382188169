"""The clauses of the road: the body stays on it and enters one lane at most, and a plan does not begin backwards."""

from __future__ import annotations

import math

import numpy as np

from dynamics.compiled import compiled
from dynamics.state import BoolArray, FloatArray, IntArray
from shield.certificate.road.clauses.others import TOUCH

__all__ = ["lanes_touched", "verdicts"]


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
    """The lanes that the body of each path touches.

    Parameters
    ----------
    state, paths : of the ego now (4,), and after each frame (n, K, 4). body : its length, its width, and its lateral
        growth on a bend [m].
    centers, side : of the lanes, and half their width [m]. owned : which of them the ego owns, (lanes,) bool.
    fails : lane that each path stops in, (n,).

    Returns
    -------
    The lane entered beside those owned and the last, (n,), which is the last without any: an owned one counts where
    the path comes back to it; the room to the road's edges, (n, 2) [m]; whether the path enters one lane at most, (n,)
    bool; and the frames before it leaves the road, (n,).
    """
    n, frames, lanes = paths.shape[0], paths.shape[1], centers.shape[0]
    entered, allowed, on_road = fails.copy(), np.ones(n, np.bool_), np.full(n, frames)
    edges = np.empty((n, 2))
    first, last = centers[0] - side, centers[lanes - 1] + side
    length, width, bare = body
    within, beside, entering = np.empty(lanes, np.bool_), np.empty(lanes, np.bool_), np.empty(lanes, np.bool_)
    for i in range(n):
        half = 0.5 * (length * abs(math.sin(state[2])) + width * abs(math.cos(state[2]))) + bare
        for j in range(lanes):
            offset = abs(state[1] - centers[j])
            within[j], beside[j], entering[j] = offset < TOUCH + half, offset < side + half, False
        least, most = np.inf, -np.inf
        for k in range(frames):
            r, psi = paths[i, k, 1], paths[i, k, 2]
            half = 0.5 * (length * abs(math.sin(psi)) + width * abs(math.cos(psi))) + bare
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
                # Nobody keeps a place free in a lane that the ego has left.
                if (touches and not (owned[j] and beside[j])) or (inside and not within[j]):
                    entering[j] = True
                within[j], beside[j] = inside, touches
        edges[i, 0], edges[i, 1] = least - first, last - most
        count = 0
        for j in range(lanes - 1, -1, -1):
            if entering[j] and j != fails[i]:
                entered[i] = j
                count += 1
        if count > 1:
            allowed[i] = False
    return entered, edges, allowed, on_road


@compiled
def verdicts(margin: FloatArray, edges: FloatArray, allowed: BoolArray, paths: FloatArray, held: int) -> FloatArray:
    """Margins (n,) with what each path lacks of room on the road (n, 2) [m]; -inf where it may not go, or rolls
    backwards after `held` frames: that has no fail-safe, the brake stands still."""
    out = np.empty(margin.shape[0])
    for i in range(margin.shape[0]):
        room = min(edges[i, 0], edges[i, 1])
        if not allowed[i] or paths[i, held - 1, 3] < -1e-9:
            out[i] = -np.inf
        elif math.isnan(edges[i, 0] + edges[i, 1]) or math.isnan(margin[i]):
            out[i] = np.nan
        else:
            out[i] = margin[i] if room >= 0 else min(margin[i], room)
    return out
