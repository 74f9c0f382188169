"""The loops of the verification: candidates x vehicles x frames, and candidates x lanes x frames.
`shield.certificate.verify` and `shield.procedures.inputs` say what they mean."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from dynamics.compiled import compiled
from dynamics.vehicle.controllers import KP_HEADING, KP_LATERAL

__all__ = [
    "TOUCH",
    "Others",
    "coming_frame",
    "in_reach",
    "lanes_held",
    "lanes_touched",
    "least_separations",
    "margins",
    "newcomers",
    "rooms",
    "sides_taken",
    "still_coming",
    "threats",
    "verdicts",
]

TOUCH = 1.0
"""How near to a lane's centre a body comes before it is in the way there [m]: half the width of a car."""
_TURNING = 0.25
"""Speed across the road, beyond that of one that settles in its lane, from which a vehicle counts as changing [m/s]."""
_STRAIGHT = 0.01
"""Sine of the heading below which a path's own next frame is where constant velocity leads."""


class Others(NamedTuple):
    """The vehicles around the ego, as a judgement of paths sees them, each (v,).

    `ahead` [m]: centre ahead of the ego's; `least` [m]: the same of the least place that the centre ever comes to;
    `size` [m]: how near it counts as touching; `behind`: whether its body is behind the ego with its buffer; `low`,
    `high` [m]: edges of the lanes that it touches; `lane`: the nearest; `r` [m], `across` [m/s]: where it is across the
    road, and its speed there; `held`: whether it is in a lane that the ego owns, or has been behind the ego in one and
    its strip is not left yet; `beside`, `comes` (lanes, v): which lanes its strip is beside, and which of these it may
    enter.
    """

    ahead: Any
    least: Any
    size: Any
    behind: Any
    low: Any
    high: Any
    lane: Any
    r: Any
    across: Any
    held: Any
    beside: Any
    comes: Any


@compiled
def _extents(paths: Any, i: int, size: Any, dt: float, coming: bool, bounds: Any) -> bool:
    """Where the ego's rectangle is in each frame: s and r from `bounds[0]`, `[2]` to `bounds[1]`, `[3]` with the
    buffer; and, with `coming`, its body one frame later at constant velocity, `bounds[4:8]`. False if not finite."""
    lon, lat, length, width = size[0], size[1], size[2], size[3]
    for k in range(paths.shape[1]):
        s, r, psi, v = paths[i, k, 0], paths[i, k, 1], paths[i, k, 2], paths[i, k, 3]
        if not (math.isfinite(s) and math.isfinite(r) and math.isfinite(psi) and math.isfinite(v)):
            return False
        sin, cos = math.sin(psi), math.cos(psi)
        half_s = lon * abs(cos) + lat * abs(sin) + size[4]
        half_r = lon * abs(sin) + lat * abs(cos) + size[5]
        bounds[0, k], bounds[1, k], bounds[2, k], bounds[3, k] = s - half_s, s + half_s, r - half_r, r + half_r
        if coming:
            s, r = s + v * cos * dt, r + v * sin * dt
            half_s = 0.5 * (length * abs(cos) + width * abs(sin)) + size[6]
            half_r = 0.5 * (length * abs(sin) + width * abs(cos)) + size[7]
            bounds[4, k], bounds[5, k], bounds[6, k], bounds[7, k] = s - half_s, s + half_s, r - half_r, r + half_r
    return True


@compiled
def coming_frame(state: Any, size: Any, ends: Any, left: float, right: float, reach: float, dt: float) -> float:
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
    half, side = 0.5 * size[2] + size[6], 0.5 * size[3] + size[7]
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


@compiled
def _front(paths: Any, i: int, center: float, at_once: int, follower: Any, duty: Any, front: Any) -> None:
    """Greatest s of a vehicle behind after each frame: it accelerates until it owes the ego its braking."""
    v0, start, stretch = follower[0], follower[1], follower[2]
    seen, reaction, gain, loss, most = duty[0], int(duty[1]), duty[2], duty[3], duty[4]
    hold, dt, power = int(duty[5]), duty[6], duty[7]
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


@compiled
def least_separations(
    paths: Any,
    size: Any,
    low: Any,
    high: Any,
    rear: Any,
    lengths: Any,
    noses: Any,
    owed: Any,
    follows: Any,
    centers: Any,
    at_once: Any,
    followers: Any,
    duty: Any,
    separations: Any,
    reached: Any,
) -> None:
    """The least separation of each path from each vehicle, and the first frame in which one is negative.

    Parameters
    ----------
    paths : (n, K, 4).
    size : half extents of the ego with its buffer, length and width of the body, growth (s, r) of the former and of
        the latter on a bend, (8,) [m].
    low, high : lateral extents of the vehicles for each path, (n or 1, m) [m]. rear : least s of each, (m, K) [m].
    lengths, noses : half the length that each covers along the road, (m,), and how far its body gets in one frame and
    in
        two, (2, m) [m].
    owed : who owes each path its distance, (n, m) bool; no rows where nobody does.
    follows : who is behind and does not, (m,) bool; of them `centers` (n or 1, m) [m] is the lane that they would see
        the ego in, `at_once` (n or 1, m) after how many frames they react if they see it all the time, or -1, and
        `followers` (3, m) are speed, front and stretch.
    duty : distance within which the ego is seen [m], frames of reaction, acceleration, braking [m/s^2], greatest speed
        [m/s], frames of constant speed before, frame duration [s], and power [m^2/s^3], (8,).
    separations : (n, m) [m], result; +inf for who owes it, NaN for a path or a vehicle that is not finite (`rear` adds
        up: its last frame tells).
    reached : frames before the first violation, (n,), result.
    """
    n, frames, m = paths.shape[0], paths.shape[1], rear.shape[0]
    bounds, front, dt = np.empty((8, frames)), np.empty(frames), duty[6]
    for i in range(n):
        coming = False
        for k in range(frames):
            psi = paths[i, k, 2]
            if not abs(psi) < _STRAIGHT and not abs(math.sin(psi)) < _STRAIGHT:
                coming = True
                break
        reached[i] = frames
        if not _extents(paths, i, size, dt, coming, bounds):
            separations[i, :], reached[i] = np.nan, 0
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


@compiled
def lanes_touched(
    paths: Any, length: float, width: float, bare: float, centers: Any, side: float, owned: Any, fails: Any
) -> tuple[Any, Any, Any, Any]:
    """The lanes that the body of each path touches.

    Parameters
    ----------
    paths : (n, K, 4). length, width, bare : of the body, and its lateral growth on a bend [m].
    centers, side : of the lanes, and half their width [m]. owned : which of them the ego owns, (lanes,) bool.
    fails : lane that each path stops in, (n,).

    Returns
    -------
    The lane entered beside those owned and the last, (n,), which is the last without any; the room to the road's
    edges, (n, 2) [m]; whether the path enters one lane at most and comes back to no owned one, (n,) bool; and the
    frames before it leaves the road, (n,).
    """
    n, frames, lanes = paths.shape[0], paths.shape[1], centers.shape[0]
    entered, allowed, on_road = fails.copy(), np.ones(n, np.bool_), np.full(n, frames)
    edges = np.empty((n, 2))
    first, last = centers[0] - side, centers[lanes - 1] + side
    within = np.empty(lanes, np.bool_)
    for i in range(n):
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
                # Nobody keeps a place free in a lane that the ego has left: it does not come back to one.
                if k > 0 and owned[j] and inside and not within[j]:
                    allowed[i] = False
                within[j] = inside
        edges[i, 0], edges[i, 1] = least - first, last - most
        count = 0
        for j in range(lanes - 1, -1, -1):
            if not owned[j] and j != fails[i] and most > centers[j] - side and least < centers[j] + side:
                entered[i] = j
                count += 1
        if count > 1:
            allowed[i] = False
    return entered, edges, allowed, on_road


@compiled
def rooms(paths: Any, size: Any, centers: Any, fails: Any, side: float, bent: bool) -> Any:
    """What is left beside the ego with its buffer in the lane that each path stops in, (n,) [m]; negative where it
    reaches out. `size` as in `least_separations`."""
    out, last = np.empty(paths.shape[0]), paths.shape[1] - 1
    for i in range(paths.shape[0]):
        r, psi = paths[i, last, 1], paths[i, last, 2]
        sin, cos = abs(math.sin(psi)), abs(math.cos(psi))
        # On a bend, what lies ahead and behind in the lane bends with the road: only the body has to fit.
        half = 0.5 * size[2] * sin + size[1] * cos + size[7] if bent else size[0] * sin + size[1] * cos
        out[i] = side - abs(r - centers[fails[i]]) - half
    return out


@compiled
def margins(separations: Any, slipping: Any, room: Any) -> Any:
    """The least separation of each path, and what it lacks of room where it does, (n,) [m]; NaN where anything is.

    Parameters
    ----------
    separations, slipping : from vehicles in reach (n, m), and from those that may slip in (n, q) [m]. room : (n,) [m].
    """
    out = np.empty(room.shape[0])
    for i in range(room.shape[0]):
        least, known = np.inf, not math.isnan(room[i])
        if room[i] < 0:
            least = room[i]
        for j in range(separations.shape[1]):
            known = known and not math.isnan(separations[i, j])
            least = min(least, separations[i, j])
        for j in range(slipping.shape[1]):
            known = known and not math.isnan(slipping[i, j])
            least = min(least, slipping[i, j])
        out[i] = least if known else np.nan
    return out


@compiled
def verdicts(margin: Any, edges: Any, allowed: Any, paths: Any, held: int) -> Any:
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


@compiled
def in_reach(others: Others, limits: Any, followers: bool) -> Any:
    """Rows of the vehicles that can come into reach of the ego, in order.

    Parameters
    ----------
    others : the vehicles, (v,).
    limits : the ego's greatest way, and the perception range, (2,) [m].
    followers : whether those behind count.
    """
    distance, perception = limits[0], limits[1]
    rows, count = np.empty(others.ahead.shape[0], np.intp), 0
    for j in range(others.ahead.shape[0]):
        # Written so that a distance that is not a number drops nobody.
        if others.least[j] - others.size[j] > distance or not abs(others.ahead[j]) <= perception:
            continue
        # Whoever is behind may still be braking, and coming nearer, long after the ego stands: none of them is too far.
        if others.behind[j] and not followers:
            continue
        rows[count] = j
        count += 1
    return rows[:count]


@compiled
def _comes_back(paths: Any, i: int, size: Any, low: float, high: float) -> bool:
    """Whether a path leaves the strip from `low` to `high` [m] with its buffer, and is in it again later: nobody keeps
    a place free that the ego has left."""
    lon, lat, frames = size[0], size[1], paths.shape[1]
    least, most = np.inf, -np.inf
    for k in range(frames):
        least, most = min(least, paths[i, k, 1]), max(most, paths[i, k, 1])
    # The ego reaches as far to either side as its own width at any heading that a path has.
    if most - lat < high and least + lat > low:
        return False
    left = False
    for k in range(frames):
        r, psi = paths[i, k, 1], paths[i, k, 2]
        half = lon * abs(math.sin(psi)) + lat * abs(math.cos(psi)) + size[5]
        inside = r - half < high and r + half > low
        if inside and left:
            return True
        left = left or not inside
    return False


@compiled
def threats(
    others: Others, limits: Any, lanes: Any, fails: Any, owned: Any, centers: Any, paths: Any, size: Any
) -> tuple[Any, Any]:
    """Rows of those in reach who do not owe the ego their distance on every path, (m,); and who of them owes it on
    which path, (n, m) bool.

    Whoever is behind the ego with its buffer, in a lane that it owns, owes it the distance, but for a path that enters
    a lane that the ego does not own and that this vehicle touches, and for one that leaves its strip and comes back.

    Parameters
    ----------
    others, limits : as in `in_reach`.
    lanes, fails : what each path commits to and stops in, (n,). owned : which lanes the ego owns, (lanes,) bool.
    centers : of the lanes [m]. paths, size : (n, K, 4), and as in `least_separations`.
    """
    n = lanes.shape[0]
    rows = in_reach(others, limits, True)
    owed, count = np.empty((n, rows.shape[0]), np.bool_), 0
    for j in rows:
        kept = False
        for i in range(n):
            entered = False
            for lane in (lanes[i], fails[i]):
                if not owned[lane]:
                    entered = entered or (
                        others.low[j] < centers[lane] + TOUCH and others.high[j] > centers[lane] - TOUCH
                    )
            owed[i, count] = others.behind[j] and others.held[j] and not entered
            if owed[i, count] and _comes_back(paths, i, size, others.low[j], others.high[j]):
                owed[i, count] = False
            kept = kept or not owed[i, count]
        if kept:
            rows[count] = j
            count += 1
    return rows[:count], owed[:, :count].copy()


@compiled
def newcomers(others: Others, gains: Any, centers: Any, width: float) -> tuple[Any, Any, Any]:
    """Which lanes each vehicle's strip is beside; which of them it may enter, for it gains by it or is on its way; and
    which it is on its way to; each (lanes, v) bool.

    On its way is one that is faster across than one that settles in the middle of its own lane, the lag of its heading
    included.

    Parameters
    ----------
    others : the vehicles, (v,). gains : see `dynamics.traffic.mobil.gains`, (v, 2) bool.
    centers, width : of the lanes [m].
    """
    n, v = centers.shape[0], others.lane.shape[0]
    beside = np.zeros((n, v), np.bool_)
    may, turning = np.zeros((n, v), np.bool_), np.zeros((n, v), np.bool_)
    for k in range(n):
        for j in range(v):
            # Beside the lane: the next strip begins where this one ends.
            apart = max(others.low[j] - centers[k], centers[k] - others.high[j])
            if not 0 < apart < width or not abs(centers[others.lane[j]] - centers[k]) < 1.5 * width:
                continue
            beside[k, j] = True
            above = centers[k] > others.high[j]
            sign = 1.0 if above else -1.0
            toward, left = sign * others.across[j], sign * (centers[others.lane[j]] - others.r[j])
            turning[k, j] = toward > KP_LATERAL * (left + toward / KP_HEADING) + _TURNING
            may[k, j] = turning[k, j] or gains[j, 1 if above else 0]
    return beside, may, turning


@compiled
def still_coming(
    beside: Any, may: Any, turning: Any, before: Any, visible: Any, stored: int, sight: int, settled: int
) -> Any:
    """Who may enter which lane although the ego has a plan to stop there, or is in sight there, (lanes, v) bool.

    Whoever may enter when that begins may do so until `sight` frames after the ego has come into sight; those who were
    on their way by then, until it has been seen for `settled` frames. Nobody joins them.

    Parameters
    ----------
    beside, may, turning : see `newcomers`. before : the answer of the scene before, (lanes, v).
    visible : frames for which the ego has been visible in each lane, (lanes,).
    stored : the lane in which the stored fail-safe stops, or -1.
    """
    out = np.zeros(may.shape, np.bool_)
    for k in range(may.shape[0]):
        for j in range(may.shape[1]):
            if visible[k] >= settled:
                out[k, j] = False
            elif visible[k] > sight:
                out[k, j] = before[k, j] and turning[k, j]
            elif visible[k] > 0 or k == stored:
                out[k, j] = before[k, j] and beside[k, j]
            else:
                out[k, j] = may[k, j]
    return out


@compiled
def sides_taken(
    paths: Any,
    lanes: Any,
    fails: Any,
    rows: Any,
    others: Others,
    centers: Any,
    settings: Any,
    low: Any,
    high: Any,
    home: Any,
) -> None:
    """Where each vehicle can be across the road, for each path: `low`, `high` (n, m) [m], and its lane `home` (n, m).

    Parameters
    ----------
    paths, lanes, fails : (n, K, 4), and the lane that each commits to, and stops in, (n,).
    rows : the vehicles, (m,). others : all of them, (v,).
    centers : of the lanes [m].
    settings : the ego's lateral position now, the distance within which it is seen, the width of a lane, and how far a
        body may lean over a marking, (4,) [m].
    """
    r, sight, width, lean = settings[0], settings[1], settings[2], settings[3]
    for i in range(paths.shape[0]):
        least, most = np.inf, -np.inf
        for k in range(paths.shape[1]):
            least, most = min(least, paths[i, k, 1]), max(most, paths[i, k, 1])
        for j in range(rows.shape[0]):
            row = rows[j]
            low[i, j], high[i, j], home[i, j] = others.low[row], others.high[row], others.lane[row]
        for step in range(2 if fails[i] != lanes[i] else 1):
            entered = lanes[i] if step == 0 else fails[i]
            goal = centers[entered]
            # Once the ego is out of sight there, anybody may come.
            leaves = abs(r - goal) <= sight < max(abs(least - goal), abs(most - goal))
            for j in range(rows.shape[0]):
                row = rows[j]
                if max(others.low[row] - goal, goal - others.high[row]) <= 0:
                    home[i, j] = entered  # it is there already, and sees the ego there
                enters = others.comes[entered, row] or (leaves and others.beside[entered, row])
                if not enters or not math.isfinite(low[i, j] + high[i, j]):
                    continue
                low[i, j] = min(low[i, j], goal - 0.5 * width - lean)
                high[i, j] = max(high[i, j], goal + 0.5 * width + lean)
                home[i, j] = entered


@compiled
def lanes_held(
    r: float, centers: Any, frames: int, sight: float, touch: float, stored: int, visible: Any, owned: Any
) -> tuple[Any, Any]:
    """The visibility clock and the lanes owned, one scene later.

    Parameters
    ----------
    r : lateral position of the ego [m]. centers : of the lanes [m].
    frames : since the scene before. sight, touch : how near to a lane's centre the ego is visible in it, and touches
        it [m].
    stored : the lane in which the stored fail-safe stops, or -1.
    visible, owned : of the scene before, (lanes,); `owned` is empty in the first.

    Returns
    -------
    Frames for which the ego has been visible in each lane, (lanes,); and whether it owns it, (lanes,) bool. A lane is
    owned from when the ego touches it with a verified plan to stop there, until it has left it.
    """
    n = centers.shape[0]
    seen, own = np.zeros(n, np.intp), np.zeros(n, np.bool_)
    here = 0
    for j in range(n):
        if abs(r - centers[j]) < abs(r - centers[here]):
            here = j
    for j in range(n):
        offset = abs(r - centers[j])
        if offset <= sight:
            seen[j] = visible[j] + frames
        had = owned[j] if owned.shape[0] > 0 else j == here
        own[j] = (had or j == stored) and offset < touch
    return seen, own
