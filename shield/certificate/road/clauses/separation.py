"""Clause of separation: a plan stays clear of every place that the other vehicles can reach, the coming frame
included."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.state import FloatArray
from dynamics.traffic.occupancy_kernels import straight_overshoot
from shield.certificate.road.clauses.clause_inputs import PlannedPath
from shield.certificate.road.clauses.footprint import Footprint

__all__ = ["FollowerResponse", "PathExtents", "UnobligatedVehicle", "coming_frame", "extents", "separation", "turns"]

_STRAIGHT = 0.01
"""Sine of the heading below which a path's own next frame covers the place that constant velocity leads to."""


class FollowerResponse(NamedTuple):
    """Follower response model.

    Attributes
    ----------
    seen : distance from its lane's centre within which a follower sees the ego [m].
    reaction : number of frames from then until it brakes. acceleration : greatest until then [m/s^2].
    braking : its deceleration [m/s^2]. max_speed : speed up to which it accelerates [m/s]. power : [m^2/s^3].
    hold : number of frames of constant speed that are expected first. dt : frame [s].
    """

    seen: float
    reaction: int
    acceleration: float
    braking: float
    max_speed: float
    power: float
    hold: int
    dt: float


class PathExtents(NamedTuple):
    """Extents of a path.

    Attributes
    ----------
    finite : whether all its numbers are finite.
    turned : whether its headings matter for the places that constant velocity leads to.
    lowest, highest : lateral extents over all frames, these places included [m].
    curvature : greatest of any path on the road [1/m]; 0 on a straight road.
    overshoot : how far the ego may leave its bend by a frame of straight motion [m].
    """

    finite: bool
    turned: bool
    lowest: float
    highest: float
    curvature: float
    overshoot: float


class UnobligatedVehicle(NamedTuple):
    """A vehicle without a distance obligation.

    Attributes
    ----------
    left, right : its lateral extents [m]. most_left, most_right : the same from frame `since` on [m].
    length : half the length that it covers along the road [m].
    overshoot : how far it may leave its bend by a frame of straight motion [m]; 0 on a straight road.
    behind : whether it is behind the ego.
    center : centre of the lane in which it would see the ego [m].
    at_once : number of frames after which it reacts if it sees the ego all the time, or -1.
    speed, front : now, [m/s] and [m]. stretch : greatest distance along the road for each metre driven.
    """

    left: float
    right: float
    most_left: float
    most_right: float
    since: int
    length: float
    overshoot: float
    behind: bool
    center: float
    at_once: int
    speed: float
    front: float
    stretch: float


@kernel_inline
def turns(path: FloatArray, turned: FloatArray) -> None:
    """Write the sine and cosine of the headings of a path (K, 4) to `turned`, (2, at least K)."""
    for k in range(path.shape[0]):
        turned[0, k], turned[1, k] = math.sin(path[k, 2]), math.cos(path[k, 2])


@kernel_inline
def extents(
    path: FloatArray, turned: FloatArray, size: Footprint, place: tuple[float, float], bounds: FloatArray
) -> PathExtents:
    """Extents of the ego's rectangle in each frame of a path (K, 4). With the buffer, s is within `bounds[0]` and
    `bounds[1]`, and r within `bounds[2]` and `bounds[3]`.

    Parameters
    ----------
    turned : see `turns`. size : the ego's footprint. bounds : (at least 4, K) [m], written.
    place : greatest curvature of any path on the road [1/m], 0 on a straight road; and duration of a frame [s].
    """
    curvature, dt = place
    lon, lat, length, width = size.along, size.across, size.length, size.width
    coming, lowest, highest, overshoot = curvature > 0, np.inf, -np.inf, 0.0
    for k in range(path.shape[0]):
        if not abs(path[k, 2]) < _STRAIGHT and not abs(turned[0, k]) < _STRAIGHT:
            coming = True
            break
    for k in range(path.shape[0]):
        s, r, psi, v = path[k, 0], path[k, 1], path[k, 2], path[k, 3]
        if not (math.isfinite(s) and math.isfinite(r) and math.isfinite(psi) and math.isfinite(v)):
            return PathExtents(False, coming, lowest, highest, curvature, overshoot)
        sin, cos = turned[0, k], turned[1, k]
        half_s = lon * abs(cos) + lat * abs(sin) + size.growth_along
        half_r = lon * abs(sin) + lat * abs(cos) + size.growth_across
        bounds[0, k], bounds[1, k], bounds[2, k], bounds[3, k] = s - half_s, s + half_s, r - half_r, r + half_r
        lowest, highest = min(lowest, bounds[2, k]), max(highest, bounds[3, k])
        overshoot = max(overshoot, straight_overshoot(curvature, length, abs(v) * dt))
        if coming:
            r += v * sin * dt
            half_r = 0.5 * (length * abs(sin) + width * abs(cos)) + size.body_growth_across
            lowest, highest = min(lowest, r - half_r), max(highest, r + half_r)
    return PathExtents(True, coming, lowest, highest, curvature, overshoot)


@kernel_no_refcount
def coming_frame(
    state: FloatArray,
    turned: tuple[float, float],
    size: Footprint,
    ends: tuple[float, float, float, float],
    sides: tuple[float, float],
    reach: float,
    dt: float,
) -> float:
    """Separation between the ego and a vehicle over one frame of constant velocities along both headings [m]; +inf if
    it is not negative.

    highway-env counts a collision if no side of either rectangle has a normal along which the two stay apart during the
    frame (`RoadObject._is_colliding`). The other's heading is not known, so the normal has to be one of the ego's:
    ahead or behind along the ego, or beside its flank, along which the ego itself does not move.

    Parameters
    ----------
    state : road state of the ego, (4,). turned : sine and cosine of its heading. size : its footprint.
    ends : least s of the other's body now and a frame later, and greatest s now and a frame later [m].
    sides : lateral extents of the other, its own lateral motion included [m].
    reach : half the length that it covers along the road [m]. dt : frame [s].
    """
    s, r, v, sin, cos = state[0], state[1], state[3], turned[0], turned[1]
    low, high = sides[0] - r, sides[1] - r
    half, side = 0.5 * size.length + size.body_growth_along, 0.5 * size.width + size.body_growth_across
    ahead = (ends[0] - s) * cos + min(low * sin, high * sin) - half
    ahead -= max(v * dt - max(ends[1] - ends[0], 0.0) * cos, 0.0)
    if ahead >= 0:
        return np.inf
    behind = -np.inf
    if math.isfinite(ends[2]):
        behind = (s - ends[2]) * cos - max(low * sin, high * sin) - half
        behind -= max((ends[3] - ends[2]) * cos - v * dt, 0.0)
    # Where any part of its body may be beside the ego, all of it has to be on one side of the flank.
    window = half + abs(v) * dt + abs(sin) * max(abs(low), abs(high)) + 2 * reach
    # The other advances along the road meanwhile, which brings a flank that is turned towards it nearer.
    moved = max(ends[3] - ends[2], 0.0) if math.isfinite(ends[3]) else 0.0
    first, last = max(ends[0] - s, -window), min(ends[3] - s, window + moved)
    if first >= last:
        return np.inf
    over = low * cos - max(first * sin, last * sin) - side
    under = min(first * sin, last * sin) - high * cos - side
    apart = max(max(ahead, behind), max(over, under))
    return apart if apart < 0 else np.inf


@kernel_inline
def _front(
    path: FloatArray, frames: int, other: UnobligatedVehicle, response: FollowerResponse, front: FloatArray
) -> float:
    """Write the greatest s of a vehicle after each frame to `front`, (at least K,) [m]. It accelerates; a follower does
    so until its braking begins. Return the distance that a follower may still advance after the last frame [m]."""
    v0, start, stretch, center, at_once = other.speed, other.front, other.stretch, other.center, other.at_once
    seen, reaction, gain, loss, most = (
        response.seen,
        response.reaction,
        response.acceleration,
        response.braking,
        response.max_speed,
    )
    hold, dt, power = response.hold, response.dt, response.power
    # The response starts when the ego has become visible for good; each loss of visibility restarts the reaction time.
    first = 1
    for k in range(frames - 1, -1, -1):
        if not abs(path[k, 1] - center) <= seen:
            first = k + 2
            break
    turn = at_once if first == 1 and at_once >= 0 else first + reaction
    if not other.behind:
        turn = frames
    way, speed, v, top = 0.0, v0, v0, max(v0, most)
    for k in range(frames):
        v = max(speed - loss * dt * max(k - turn, 0), 0.0)
        way += v
        front[k] = start + way * dt * stretch
        if hold <= k < turn:
            speed = min(speed + min(gain, power / max(speed, 1e-3)) * dt, top)
    # Where the ego has come to rest in the last frame, its follower may still be braking.
    more = 0.0
    if other.behind and path[frames - 1, 3] < 0.5:
        k = frames
        while k <= turn or v > 0:
            v = max(speed - loss * dt * max(k - turn, 0), 0.0)
            more += v
            if k < turn:
                speed = min(speed + min(gain, power / max(speed, 1e-3)) * dt, top)
            k += 1
    return more * dt * stretch


@kernel_inline
def separation(
    plan: PlannedPath,
    ego: PathExtents,
    bounds: FloatArray,
    size: Footprint,
    other: UnobligatedVehicle,
    rear: FloatArray,
    response: FollowerResponse,
) -> tuple[float, int]:
    """Least separation of a path from a vehicle without a distance obligation [m], and the first frame in which
    it is negative, or K. NaN and 0 for a vehicle that is not finite: `rear` is cumulative, so that its last frame shows
    it.

    Parameters
    ----------
    plan : the path. ego, bounds : its `extents`; `bounds[4]` is a buffer. size : the ego's footprint.
    other : the vehicle. rear : least s of its body after each frame, (at least K,) [m]. response : follower response
        model.
    """
    path, turned, front = plan.path, plan.turned, bounds[4]
    frames, left, right, behind, dt = path.shape[0], other.left, other.right, other.behind, response.dt
    since = other.since
    known = math.isfinite(left + right + rear[frames - 1])
    if not known or ((behind or ego.turned) and not math.isfinite(other.speed + other.front + other.stretch)):
        return np.nan, 0
    beside = max(left - ego.highest, ego.lowest - right)
    if since < frames:
        beside = max(other.most_left - ego.highest, ego.lowest - other.most_right)
    if beside >= max(other.overshoot, ego.overshoot):
        return beside, frames
    more = 0.0
    if behind or ego.turned:
        more = _front(path, frames, other, response, front)
    least, first = beside if beside >= 0 else np.inf, frames
    for k in range(frames):
        if k == since:
            left, right = other.most_left, other.most_right
        along = rear[k] - bounds[1, k]
        if behind:
            along = max(along, bounds[0, k] - front[k] - (more if k == frames - 1 else 0.0))
        apart = max(along, max(left - bounds[3, k], bounds[2, k] - right))
        # The frame after the last is not judged: an ego that brakes stands by then.
        if ego.turned and k < frames - 1 and (ego.curvature > 0 or not abs(turned[0, k]) < _STRAIGHT):
            ends, heading = (rear[k], rear[k + 1], front[k], front[k + 1]), (turned[0, k], turned[1, k])
            # The body on the inner side of a bend leaves the lane beside the outer one by this much.
            over = max(other.overshoot, straight_overshoot(ego.curvature, size.length, abs(path[k, 3]) * dt))
            sides = left - over, right + over
            apart = min(apart, coming_frame(path[k], heading, size, ends, sides, other.length, dt))
        least = min(least, apart)
        if apart < 0:
            first = min(first, k)
    return least, first
