"""Who owes the ego its distance, and which lanes are its own: of whom a plan has to stay clear."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import compiled, inlined, uncounted
from dynamics.roads.straight import nearest
from dynamics.state import BoolArray, FloatArray, IntArray, Vehicle
from dynamics.traffic.mobil import gains
from dynamics.traffic.rules_of_the_road import Ego, gap_between
from dynamics.traffic.tables import Bodies
from shield.certificate.road.clauses.entering import entrants, neighbours
from shield.certificate.road.clauses.footprint import Footprint, across_of, reach_across, reach_along
from shield.certificate.road.clauses.others import TOUCH, Others

__all__ = ["Sight", "Standing", "counted_on", "hold_lanes", "in_reach", "lanes_held", "others_of", "threats"]

_LENGTH, _WIDTH = int(Vehicle.LENGTH), int(Vehicle.WIDTH)
_LONG = 10**6
"""Frames that stand for as long as one likes."""
_BESIDE = 1.0
"""How far a plan may come out of the way from where the ego is to where it stops, beside what its heading takes [m]."""
_LEFT = 0.5
"""How far beside a strip the ego's buffer is before the ego has left it: a buffer that turns sways [m]."""
_CORNER = 0.5
"""How far a corner of a vehicle behind may come beside a corner of the ego's buffer [m]."""


class Sight(NamedTuple):
    """What decides about who sees whom.

    `distance`: from a lane's centre within which a vehicle is seen there [m]; `slack` [m/s^2]: on what one gains that
    enters a lane; `reaction`, `settled`: frames for which the ego has been in sight after which nobody begins to enter,
    and nobody enters any more; `blind`: whether anybody enters a lane that the ego is about to; `width`: of a lane [m].
    """

    distance: float
    slack: float
    reaction: int
    settled: int
    blind: bool
    width: float


@inlined
def in_reach(others: Others, limits: tuple[float, float], followers: bool, rows: IntArray) -> int:
    """How many vehicles can come into reach of the ego; the first of `rows` (v,) are theirs, in order.

    Parameters
    ----------
    others : the vehicles, (v,).
    limits : the ego's greatest way, and the perception range, (2,) [m].
    followers : whether those behind count.
    """
    distance, perception = limits[0], limits[1]
    least, size, ahead, behind = others.least, others.size, others.ahead, others.behind
    count = 0
    for j in range(ahead.shape[0]):
        # Written so that a distance that is not a number drops nobody.
        if least[j] - size[j] > distance or not abs(ahead[j]) - size[j] <= perception:
            continue
        # Whoever is behind may still be braking, and coming nearer, long after the ego stands: none of them is too far.
        if behind[j] and not followers:
            continue
        rows[count] = j
        count += 1
    return count


@inlined
def _comes_back(
    state: FloatArray, path: FloatArray, turned: FloatArray, size: Footprint, low: float, high: float
) -> bool:
    """Whether the ego has left the strip from `low` to `high` [m] with its buffer by more than `_LEFT`, now or on its
    path, and is in it again later: nobody keeps a place free that the ego has left. `state` is where it is now (4,)."""
    lat, frames = size.across, path.shape[0]
    least, most = state[1], state[1]
    for k in range(frames):
        least, most = min(least, path[k, 1]), max(most, path[k, 1])
    # The ego reaches as far to either side as its own width at any heading that a path has.
    if most - lat < high and least + lat > low:
        return False
    half = reach_across(size, state[2])
    left = not (state[1] - half < high + _LEFT and state[1] + half > low - _LEFT)
    for k in range(frames):
        r, half = path[k, 1], across_of(size, turned[0, k], turned[1, k])
        inside = r - half < high and r + half > low
        if inside and left:
            return True
        left = left or not (r - half < high + _LEFT and r + half > low - _LEFT)
    return False


@inlined
def threats(
    others: Others,
    limits: tuple[float, float],
    lane: int,
    fail: int,
    owned: BoolArray,
    centers: FloatArray,
    state: FloatArray,
    path: FloatArray,
    turned: FloatArray,
    size: Footprint,
    rows: IntArray,
) -> int:
    """How many of those in reach do not owe the ego their distance on a path. The first of `rows` (v,) are theirs.

    Whoever is behind the ego with its buffer, in a lane that it owns, owes it the distance, but for a path that enters
    a lane that the ego does not own and that this vehicle touches or may enter too, and for one that leaves its strip
    and comes back; in its place counts where the ego stops, for a strip that reaches there.

    Parameters
    ----------
    others, limits : as in `in_reach`.
    lane, fail : what the path commits to and stops in. owned : which lanes the ego owns, (lanes,) bool.
    centers : of the lanes [m]. state : of the ego now, (4,). path, turned, size : as in `extents`.
    """
    low, high, behind, held = others.low, others.high, others.behind, others.held
    reached, count, stand = in_reach(others, limits, True, rows), 0, size.across + _LEFT
    for place in range(reached):
        j = rows[place]
        owes = behind[j] and held[j]
        if owes:
            for entered in (lane, fail):
                if not owned[entered]:
                    touches = low[j] < centers[entered] + TOUCH and high[j] > centers[entered] - TOUCH
                    owes = owes and not (touches or others.comes[entered, j])
        if owes:
            # A strip may shrink while the plan lasts, as far as to the place where the ego stops; the lane that this is
            # in may come to be the ego's meanwhile.
            least, most = low[j], high[j]
            if least < centers[fail] + stand and most > centers[fail] - stand:
                least, most = centers[fail] - stand, centers[fail] + stand
            owes = not _comes_back(state, path, turned, size, least, most)
        if not owes:
            rows[count] = j
            count += 1
    return count


@uncounted
def counted_on(
    others: Others,
    state: FloatArray,
    size: Footprint,
    centers: FloatArray,
    plan: tuple[int, int],
    owned: BoolArray,
    before: tuple[BoolArray, BoolArray],
    counted: BoolArray,
) -> None:
    """Fill in which vehicles a stored plan counts on to brake, `counted` (v,): those that were behind the ego a frame
    before and may be in its way, without those that it leaves out because they owe the ego their distance.

    A vehicle that owed its distance and has moved aside may be left out no more: where it no longer reaches the place
    where the ego stops, the plan may sway back into its strip, and where the plan enters a lane on the way, it may join
    that lane. Both are counted on to leave the plan its room.

    Parameters
    ----------
    others : the vehicles, (v,). state, size : of the ego: road state (4,) and footprint. centers : of the lanes [m].
    plan : the lane in which the stored plan stops, and the one that it enters on the way, or -1. owned : which lanes
        the ego owns, (lanes,) bool. before : who was behind the ego in the scene before, and in a lane that it owned,
        (v,) bool.
    """
    keeps = owned[plan[0]] and (plan[1] < 0 or owned[plan[1]])
    half, goal, stand = reach_across(size, state[2]) + _BESIDE, centers[plan[0]], size.across + _LEFT
    least, most = min(state[1], goal) - half, max(state[1], goal) + half
    for j in range(counted.shape[0]):
        low, high = others.low[j], others.high[j]
        near = plan[1] >= 0 or others.comes[plan[0], j] or (low < most and high > least)
        reaches = low < goal + stand and high > goal - stand
        counted[j] = before[0][j] and near and not (keeps and before[1][j] and others.held[j] and reaches)


@uncounted
def hold_lanes(
    r: float,
    centers: FloatArray,
    frames: int,
    sight: float,
    touch: float,
    leave: float,
    stored: int,
    first: bool,
    visible: IntArray,
    owned: BoolArray,
    owing: BoolArray,
    coming: BoolArray,
) -> None:
    """The visibility clock, the lanes owned, and who could enter which before, one scene later, in their place.

    Parameters
    ----------
    r : lateral position of the ego [m]. centers : of the lanes [m].
    frames : since the scene before. sight, touch, leave : how near to a lane's centre the ego is visible in it, touches
        it, and has not left it with all of its body [m].
    stored : the lane in which the stored fail-safe stops, or -1.
    first : whether this is the first scene; whoever is there when it all begins has seen the ego for long.
    visible : frames for which the ego has been visible in each lane, (lanes,).
    owned : which it owns, (lanes,): from when it touches one with a verified plan to stop there, until its body has
        left it and no stored plan stops there any more.
    owing : who owed the ego its distance, (m,). coming : who could enter which lane, (lanes, m), or of no lanes.
        All but the former may come into a lane that the ego has got out of sight in.
    """
    here = nearest(centers, r)
    for j in range(centers.shape[0]):
        offset, last = abs(r - centers[j]), visible[j]
        visible[j] = (_LONG if first else last) + frames if offset <= sight else 0
        had = j == here if first else owned[j]
        owned[j] = (had and (offset < leave or j == stored)) or (j == stored and offset < touch)
        if not first and coming.shape[0] > 0 and last > 0 and visible[j] == 0:
            for i in range(coming.shape[1]):
                coming[j, i] = coming[j, i] or not owing[i]


@compiled
def lanes_held(
    r: float,
    centers: FloatArray,
    frames: int,
    sight: float,
    touch: float,
    leave: float,
    stored: int,
    visible: IntArray,
    owned: BoolArray,
    owing: BoolArray,
    coming: BoolArray,
) -> tuple[IntArray, BoolArray, BoolArray]:
    """`hold_lanes` with new arrays; `visible` and `owned` of the scene before are empty in the first, and `coming` may
    be of any other shape without one."""
    n, first = centers.shape[0], visible.shape[0] != centers.shape[0]
    seen, own, comes = np.zeros(n, np.intp), np.zeros(n, np.bool_), coming.copy()
    if not first:
        seen[:] = visible
        if owned.shape[0] == n:
            own[:] = owned
        else:
            own[nearest(centers, r)] = True
    coming = comes if comes.shape[0] == n else comes[:0]
    hold_lanes(r, centers, frames, sight, touch, leave, stored, first, seen, own, owing, coming)
    return seen, own, comes


class Standing(NamedTuple):
    """Where the ego stands: `state` on the road (4,); `size`; `seen`, the same in the world; `owned`, which lanes it
    owns, and `visible`, for how many frames it has been visible in each, (lanes,); `stored`: the lane in which its
    stored plan stops, and `entered`: the one that it enters on the way, or -1."""

    state: FloatArray
    size: Footprint
    seen: Ego
    owned: BoolArray
    visible: IntArray
    stored: int
    entered: int


@uncounted
def others_of(
    rows: FloatArray,
    states: FloatArray,
    bodies: Bodies,
    ego: Standing,
    followers: BoolArray,
    before: BoolArray,
    sight: Sight,
    centers: FloatArray,
    others: Others,
    room: BoolArray,
) -> None:
    """Fill in the vehicles as a judgement of paths sees them, `others`; `room` (m, 4) is written over.

    Parameters
    ----------
    rows, states, bodies : vehicle rows (m, 7), road states (m, 4), and what is known of their bodies.
    ego : where it stands.
    followers : who owed it the distance in the scene before, (m,) bool; empty without one.
    before : see `still_coming`; without a scene before, it has another shape.
    """
    state, size, owned = ego.state, ego.size, ego.owned
    lows, highs, floor, reach = bodies.low, bodies.high, bodies.floor, bodies.reach
    aheads, leasts, near, rs, across = others.ahead, others.least, others.size, others.r, others.across
    behinds, helds = others.behind, others.held
    half, side = reach_along(size, state[2]), reach_across(size, state[2])
    for j in range(states.shape[0]):
        ahead = states[j, 0] - state[0]
        sin, cos = math.sin(states[j, 2]), math.cos(states[j, 2])
        # Who is behind is told from where the body is now: its reach is for wherever it may turn to.
        beyond = ahead + 0.5 * (rows[j, _LENGTH] * abs(cos) + rows[j, _WIDTH] * abs(sin)) + half
        behind, followed = beyond <= 0, followers.shape[0] > 0 and followers[j]
        if followed and not behind and beyond <= _CORNER:
            # One that owes the ego its distance does so still where a corner of it has come beside a corner of the
            # ego's buffer, until it touches it.
            behind = gap_between(ego.seen, ego.seen.along, ego.seen.across, rows, j, 0.0) >= 0
        low, high, held = lows[j], highs[j], False
        for k in range(centers.shape[0]):
            held = held or (owned[k] and low < centers[k] + TOUCH and high > centers[k] - TOUCH)
        # The duty lasts until the ego has left the strip of the one that owes it.
        held = held or (followed and low < state[1] + side and high > state[1] - side)
        aheads[j], behinds[j], helds[j] = ahead, behind, held
        leasts[j] = min(ahead, floor[j] - state[0])
        near[j] = reach[j] + size.along + size.growth_along + 2.0
        rs[j], across[j] = states[j, 1], states[j, 3] * sin
    if not sight.blind:
        for k in range(centers.shape[0]):
            for j in range(states.shape[0]):
                others.beside[k, j] = others.comes[k, j] = False
        return
    asked, tempted = room[:, :2], room[:, 2:]
    plan = (ego.stored, ego.entered)
    neighbours(others, centers, sight.width, before, ego.visible, plan, asked)
    strip = (bodies.lane, bodies.low, bodies.high)
    gains(states, across, *strip, centers, sight.distance, sight.slack, state, asked, tempted)
    entrants(others, tempted, centers, before, ego.visible, plan, sight.reaction, sight.settled)
