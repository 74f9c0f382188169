"""The clause of separation: a plan stays clear of every place where the others can be, the coming frame included."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import uncounted
from dynamics.state import BoolArray, FloatArray, IntArray
from shield.certificate.clauses.footprint import Footprint

__all__ = ["Duty", "Extents", "coming_frame", "least_separations"]

_STRAIGHT = 0.01
"""Sine of the heading below which a path's own next frame is where constant velocity leads."""


class Duty(NamedTuple):
    """What a vehicle behind owes: distance within which it sees the ego [m], frames of reaction, greatest acceleration
    and the braking that it owes [m/s^2], speed up to which it accelerates [m/s], power [m^2/s^3], frames of constant
    speed that are expected before, and frame duration [s]."""

    seen: float
    reaction: int
    acceleration: float
    braking: float
    max_speed: float
    power: float
    hold: int
    dt: float


@uncounted
def _extents(paths: FloatArray, i: int, size: Footprint, dt: float, coming: bool, bounds: FloatArray) -> bool:
    """Where the ego's rectangle is in each frame: s and r from `bounds[0]`, `[2]` to `bounds[1]`, `[3]` with the
    buffer; and, with `coming`, its body one frame later at constant velocity, `bounds[4:8]`. False if not finite."""
    lon, lat, length, width = size.along, size.across, size.length, size.width
    for k in range(paths.shape[1]):
        s, r, psi, v = paths[i, k, 0], paths[i, k, 1], paths[i, k, 2], paths[i, k, 3]
        if not (math.isfinite(s) and math.isfinite(r) and math.isfinite(psi) and math.isfinite(v)):
            return False
        sin, cos = math.sin(psi), math.cos(psi)
        half_s = lon * abs(cos) + lat * abs(sin) + size.growth_along
        half_r = lon * abs(sin) + lat * abs(cos) + size.growth_across
        bounds[0, k], bounds[1, k], bounds[2, k], bounds[3, k] = s - half_s, s + half_s, r - half_r, r + half_r
        if coming:
            s, r = s + v * cos * dt, r + v * sin * dt
            half_s = 0.5 * (length * abs(cos) + width * abs(sin)) + size.bare_along
            half_r = 0.5 * (length * abs(sin) + width * abs(cos)) + size.bare_across
            bounds[4, k], bounds[5, k], bounds[6, k], bounds[7, k] = s - half_s, s + half_s, r - half_r, r + half_r
    return True


@uncounted
def coming_frame(
    state: FloatArray,
    size: Footprint,
    ends: tuple[float, float, float, float],
    left: float,
    right: float,
    reach: float,
    dt: float,
) -> float:
    """What is left between the ego and a vehicle over one frame of constant velocities along both headings [m]; +inf
    where there is anything left.

    highway-env counts a collision where no side of either rectangle has a normal along which the two stay apart
    meanwhile (`RoadObject._is_colliding`). The other's heading is not known, so it has to be one of the ego's: ahead or
    behind along the ego, or beside its flank, along which the ego itself does not move. `ends` are least s of the
    other's body now and then, and greatest s of both [m]; `left`, `right` contain its own way sideways; `reach` is half
    the length that it covers.
    """
    s, r, psi, v = state[0], state[1], state[2], state[3]
    sin, cos = math.sin(psi), math.cos(psi)
    low, high = left - r, right - r
    half, side = 0.5 * size.length + size.bare_along, 0.5 * size.width + size.bare_across
    ahead = (ends[0] - s) * cos + min(low * sin, high * sin) - half
    ahead -= max(v * dt - max(ends[1] - ends[0], 0.0) * cos, 0.0)
    behind = -np.inf
    if math.isfinite(ends[2]):
        behind = (s - ends[2]) * cos - max(low * sin, high * sin) - half
        behind -= max((ends[3] - ends[2]) * cos - v * dt, 0.0)
    # Where any of its body may be beside the ego, all of it has to be on one side of the flank.
    window = half + abs(v) * dt + abs(sin) * max(abs(low), abs(high)) + 2 * reach
    # The other gets on along the road meanwhile, and that brings a flank that is turned towards it nearer.
    moved = max(ends[3] - ends[2], 0.0) if math.isfinite(ends[3]) else 0.0
    first, last = max(ends[0] - s, -window), min(ends[3] - s, window + moved)
    if first >= last:
        return np.inf
    over = low * cos - max(first * sin, last * sin) - side
    under = min(first * sin, last * sin) - high * cos - side
    apart = max(max(ahead, behind), max(over, under))
    return apart if apart < 0 else np.inf


@uncounted
def _front(
    paths: FloatArray, i: int, center: float, at_once: int, follower: FloatArray, duty: Duty, front: FloatArray
) -> None:
    """Greatest s of a vehicle behind after each frame: it accelerates until it owes the ego its braking."""
    v0, start, stretch = follower[0], follower[1], follower[2]
    seen, reaction, gain, loss, most = duty.seen, duty.reaction, duty.acceleration, duty.braking, duty.max_speed
    hold, dt, power = duty.hold, duty.dt, duty.power
    frames = paths.shape[1]
    # The duty starts when the ego has come into sight for good; losing sight of it starts the clock again.
    first = 1
    for k in range(frames - 1, -1, -1):
        if not abs(paths[i, k, 1] - center) <= seen:
            first = k + 2
            break
    turn = at_once if first == 1 and at_once >= 0 else first + reaction
    way, speed, v, top = 0.0, v0, v0, max(v0, most)
    for k in range(frames):
        v = max(speed - loss * dt * max(k - turn, 0), 0.0)
        way += v
        front[k] = start + way * dt * stretch
        if hold <= k < turn:
            speed = min(speed + min(gain, power / max(speed, 1e-3)) * dt, top)
    # Where the ego has come to rest at the last frame, its follower may still be doing so.
    if paths[i, frames - 1, 3] < 0.5:
        front[frames - 1] += (v * v / (2 * loss) + 0.5 * v * dt) * stretch


class Extents(NamedTuple):
    """Where m vehicles can be, for each of n paths.

    `low`, `high` (n or 1, m) [m]: across the road; `rear` (m, K) [m]: least s of each; `lengths` (m,), `noses` (2, m)
    [m]: half the length that each covers along the road, and how far its body gets in one frame and in two; `owed`
    (n, m): who owes each path its distance, no rows where nobody does; `follows` (m,): who is behind and does not. Of
    those, `centers` (n or 1, m) [m] is the lane that they would see the ego in, `at_once` (n or 1, m) after how many
    frames they react if they see it all the time, or -1, and `followers` (3, m) are speed, front and stretch.
    """

    low: FloatArray
    high: FloatArray
    rear: FloatArray
    lengths: FloatArray
    noses: FloatArray
    owed: BoolArray
    follows: BoolArray
    centers: FloatArray
    at_once: IntArray
    followers: FloatArray


@uncounted
def least_separations(
    paths: FloatArray,
    size: Footprint,
    others: Extents,
    duty: Duty,
    separations: FloatArray,
    reached: IntArray,
    bounds: FloatArray,
    front: FloatArray,
) -> None:
    """The least separation of each path from each vehicle, and the first frame in which one is negative.

    Parameters
    ----------
    paths : (n, K, 4). size : the ego's footprint. others : where they can be. duty : what a vehicle behind owes.
    separations : (n, m) [m], result; +inf for who owes it, NaN for a path or a vehicle that is not finite (`rear` adds
        up: its last frame tells).
    reached : frames before the first violation, (n,), result.
    bounds, front : room that is written over, (8, K) and (K,).
    """
    low, high, rear, lengths, noses = others.low, others.high, others.rear, others.lengths, others.noses
    owed, follows, centers, at_once, followers = (
        others.owed,
        others.follows,
        others.centers,
        others.at_once,
        others.followers,
    )
    n, frames, m = paths.shape[0], paths.shape[1], rear.shape[0]
    dt = duty.dt
    for i in range(n):
        coming = False
        for k in range(frames):
            psi = paths[i, k, 2]
            if not abs(psi) < _STRAIGHT and not abs(math.sin(psi)) < _STRAIGHT:
                coming = True
                break
        reached[i] = frames
        if not _extents(paths, i, size, dt, coming, bounds):
            reached[i] = 0
            for j in range(m):
                separations[i, j] = np.nan
            continue
        lowest, highest = np.inf, -np.inf
        for k in range(frames):
            lowest, highest = min(lowest, bounds[2, k]), max(highest, bounds[3, k])
            if coming:
                lowest, highest = min(lowest, bounds[6, k]), max(highest, bounds[7, k])
        for j in range(m):
            if owed.shape[0] > 0 and owed[i, j]:
                separations[i, j] = np.inf
                continue
            of = min(i, low.shape[0] - 1)
            least, left, right, behind = np.inf, low[of, j], high[of, j], follows[j]
            known = math.isfinite(left + right + rear[j, frames - 1])
            if not known or (behind and not math.isfinite(followers[0, j] + followers[1, j] + followers[2, j])):
                separations[i, j], reached[i] = np.nan, 0
                continue
            beside = max(left - highest, lowest - right)
            if beside >= 0:
                separations[i, j] = beside
                continue
            if behind:
                of = min(i, centers.shape[0] - 1)
                _front(paths, i, centers[of, j], at_once[of, j], followers[:, j], duty, front)
            for k in range(frames):
                along = rear[j, k] - bounds[1, k]
                if behind:
                    along = max(along, bounds[0, k] - front[k])
                apart = max(along, max(left - bounds[3, k], bounds[2, k] - right))
                # Nothing is said about the frame after the last: an ego that brakes stands by then.
                if coming and k == 0 and frames > 1:
                    ends = (rear[j, 0], rear[j, 1], noses[0, j], noses[1, j])
                    apart = min(apart, coming_frame(paths[i, 0], size, ends, left, right, lengths[j], dt))
                elif coming and k < frames - 1:
                    along = rear[j, k + 1] - bounds[5, k]
                    if behind:
                        along = max(along, bounds[4, k] - front[k + 1])
                    later = max(along, max(left - bounds[7, k], bounds[6, k] - right))
                    if later < 0:
                        apart = min(apart, later)
                least = min(least, apart)
                if apart < 0:
                    reached[i] = min(reached[i], k)
            separations[i, j] = least
