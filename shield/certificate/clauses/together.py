"""All that is said against paths, in two compiled calls: one for a scene, and one for paths in it.

They are handed arrays and nothing else, which get their names inside; `dynamics.traffic.tables` says why.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.compiled import compiled, numbers_of
from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.traffic.occupancy_kernels import fronts, rears
from dynamics.traffic.permits import Ego
from dynamics.traffic.tables import Bodies, Motion, bodies_of, motion_of
from shield.certificate.clauses.duties import Standing, others_of, threats
from shield.certificate.clauses.entering import sides_taken
from shield.certificate.clauses.footprint import Footprint
from shield.certificate.clauses.others import Others, others_from
from shield.certificate.clauses.plans import Plans
from shield.certificate.clauses.room import margins, rooms
from shield.certificate.clauses.separation import Extents, least_separations
from shield.certificate.clauses.settings import Settings, duty_of, settings_from, sight_of
from shield.certificate.clauses.slip_in import anybody, least_separations_of_slips, may_slip, slips_of, sweeps

__all__ = ["NOTHING_BINDS", "ROOM_BINDS", "SEPARATION_BINDS", "SLIP_IN_BINDS", "judged", "seen"]

NOTHING_BINDS, SEPARATION_BINDS, SLIP_IN_BINDS, ROOM_BINDS = 0, 1, 2, 3
"""What a margin comes from."""


class Ground(NamedTuple):
    """Centres of the lanes [m], which of them the ego owns, and for how many frames it has been visible in each."""

    centers: FloatArray
    owned: BoolArray
    visible: IntArray


class Around(NamedTuple):
    """The others of a scene: `rows` (m, 7), `states` (m, 4), what a metre driven is of the road, `stretch` (2, m or 0),
    `bodies`, `motion` and `others`."""

    rows: FloatArray
    states: FloatArray
    stretch: FloatArray
    bodies: Bodies
    motion: Motion
    others: Others


@compiled
def seen(
    rows: FloatArray,
    states: FloatArray,
    marks: IntArray,
    numbers: FloatArray,
    brakes: FloatArray,
    recent: FloatArray,
    vehicle: FloatArray,
    state: FloatArray,
    size: FloatArray,
    centers: FloatArray,
    settings: FloatArray,
    owned: BoolArray,
    visible: IntArray,
    stored: int,
    followers: FloatArray,
    before: BoolArray,
    of_others: FloatArray,
    flags: BoolArray,
    slipping: FloatArray,
) -> int:
    """Take in a scene: fill in what is to be known of the others before any path is judged.

    Parameters
    ----------
    rows, states : vehicle rows (m, 7), and road states (m, 4). marks, numbers, brakes, recent : their `Tables`.
    vehicle, state, size : of the ego: vehicle row (7,), road state (4,), numbers of its `Footprint` (8,).
    centers, settings : of the lanes [m]; numbers of `Settings`.
    owned, visible, stored : see `Standing`.
    followers, before : see `others_of`.
    of_others, flags : of `Others`, see `empty_others`; result.
    slipping : (2 m, 4), rows of those that `may_slip` finds; result.

    Returns
    -------
    How many may slip in.
    """
    x, bodies, foot = (
        settings_from(settings),
        bodies_of(marks, numbers, brakes, recent),
        Footprint(*numbers_of(size, 8)),
    )
    body = 0.5 * foot.length, 0.5 * foot.width
    world = Ego(vehicle[0], vehicle[1], vehicle[2], vehicle[3], foot.along, foot.across, body[0], body[1], False)
    others = others_from(bodies, of_others, flags)
    ego = Standing(state, foot, world, owned, visible, stored)
    others_of(rows, states, bodies, ego, followers, before, sight_of(x), centers, others)
    if not x.slip_in > 0:
        return 0
    return may_slip(rows, states, bodies, state, foot.length, centers, x.seen, x.hardest, slipping)


@compiled
def _separations(
    plans: Plans,
    r: float,
    foot: Footprint,
    ground: Ground,
    around: Around,
    near: IntArray,
    owed: BoolArray,
    x: Settings,
    hold: int,
    reached: IntArray,
) -> FloatArray:
    """The least separation of each path from each vehicle `near` (q,) that does not owe it, `owed` (n, q), (n, q) [m];
    `r` is where the ego is across the road."""
    n, frames, q = plans.paths.shape[0], plans.paths.shape[1], near.shape[0]
    others, centers, duty, bound = around.others, ground.centers, duty_of(x, hold), x.blind > 0 and hold == 0
    low, high = np.empty((n if bound else 1, q)), np.empty((n if bound else 1, q))
    home = np.empty(low.shape, np.intp)
    if bound:
        settings = (r, x.seen, x.width, x.lean)
        sides_taken(plans, near, others, centers, settings, low, high, home)
    else:
        low[0], high[0], home[0] = others.low[near], others.high[near], others.lane[near]
    rear = np.empty((q, frames))
    rears(near, around.rows, around.states, around.stretch, around.motion, around.bodies, hold, rear)
    goals, at_once, visible = np.empty(home.shape), np.full(home.shape, -1), ground.visible
    for i in range(home.shape[0]):
        for j in range(q):
            goals[i, j] = centers[home[i, j]]
            already = visible[home[i, j]]
            if already > 0:
                at_once[i, j] = max(duty.reaction + 1 - already, 0)
    followers, lengths, noses = np.ones((3, q)), np.empty(q), np.empty((2, q))
    reach, ends, states, stretch = around.bodies.reach, around.bodies.noses, around.states, around.stretch
    for j in range(q):
        k = near[j]
        lengths[j], noses[0, j], noses[1, j] = reach[k], ends[0, k], ends[1, k]
        followers[0, j], followers[1, j] = states[k, 3], states[k, 0] + lengths[j]
        if stretch.shape[1] > 0:
            followers[2, j] = stretch[1, k]
    separations, behind = np.empty((n, q)), others.behind[near]
    extents = Extents(low, high, rear, lengths, noses, owed, behind, goals, at_once, followers)
    least_separations(plans.paths, foot, extents, duty, separations, reached)
    return separations


@compiled
def _slips(
    paths: FloatArray,
    foot: Footprint,
    centers: FloatArray,
    table: FloatArray,
    ignored: BoolArray,
    around: Around,
    found: FloatArray,
    x: Settings,
) -> FloatArray:
    """The least separation of each path from each of those `found` that may slip in, (n, c) [m]; +inf where it does
    not."""
    n, frames, c = paths.shape[0], paths.shape[1], found.shape[0]
    out = np.full((n, c), np.inf)
    if c == 0:
        return out
    rows, slips = slips_of(found, around.states, around.bodies, centers, x.acceleration, x.hardest)
    if not anybody(paths, slips, centers, x.seen, x.dt):
        return out
    # The last frame of `rears` stands for all that follow it; none of those asked for is that.
    rear, front = np.empty((c, frames + 1)), np.empty((c, frames + 1))
    rears(rows, around.rows, around.states, around.stretch, around.motion, around.bodies, 0, rear)
    fronts(rows, around.states, around.stretch, around.motion, around.bodies, 0, front)
    sweep = sweeps(rows, slips, around.rows, around.states, around.bodies, table, x.dt)
    least_separations_of_slips(paths, foot, slips, rear, front, sweep, centers, x.seen, x.dt, out)
    if ignored.shape[0] > 0:
        for k in range(c):
            if ignored[rows[k]]:
                out[:, k] = np.inf
    return out


@compiled
def _binding(
    margin: float, separations: FloatArray, near: IntArray, apart: FloatArray, slips: FloatArray
) -> tuple[int, int]:
    """What a margin comes from, and which vehicle."""
    if separations.shape[0] > 0 and separations.min() <= margin:
        return SEPARATION_BINDS, near[separations.argmin()]
    if apart.shape[0] > 0 and apart.min() <= margin:
        return SLIP_IN_BINDS, int(slips[apart.argmin(), 0])
    return (NOTHING_BINDS if margin == np.inf else ROOM_BINDS), -1


@compiled
def judged(
    paths: FloatArray,
    lanes: IntArray,
    fails: IntArray,
    state: FloatArray,
    size: FloatArray,
    centers: FloatArray,
    settings: FloatArray,
    motion: FloatArray,
    table: FloatArray,
    hold: int,
    owned: BoolArray,
    visible: IntArray,
    ignored: BoolArray,
    rows: FloatArray,
    states: FloatArray,
    stretch: FloatArray,
    marks: IntArray,
    numbers: FloatArray,
    brakes: FloatArray,
    recent: FloatArray,
    of_others: FloatArray,
    flags: BoolArray,
    slipping: FloatArray,
) -> tuple[FloatArray, IntArray, IntArray]:
    """What is said against paths.

    Parameters
    ----------
    paths, lanes, fails : (n, K, 4), and the lane that each commits to, and stops in, (n,).
    state, size : of the ego: road state (4,), numbers of its `Footprint` (8,).
    centers : of the lanes [m]. settings, motion : numbers of `Settings`, and of `Motion`.
    table : of the road, see `dynamics.vehicle.rollout_kernels`.
    hold : frames of constant speed, which make a forecast of it, and no bound.
    owned, visible : which lanes it owns, and for how many frames it has been visible in each, (lanes,).
    ignored : vehicles to leave out, (m,) bool, or none of them (0,).
    rows, states, stretch, marks, numbers, brakes, recent, of_others, flags, slipping : of the others, see `seen`; and
        what a metre driven is of the road, (2, m or 0).

    Returns
    -------
    Of each path its margin, the room in the lane that is stopped in, the least separation from each vehicle in reach,
    and from each that slips in, (2 + q + c, n) [m]; frames before the first separation that is negative, what the
    margin comes from, and the vehicle, (3, n); and the vehicles in reach, (q,).
    """
    n, frames = paths.shape[0], paths.shape[1]
    x, foot = settings_from(settings), Footprint(*numbers_of(size, 8))
    bodies = bodies_of(marks, numbers, brakes, recent)
    others = others_from(bodies, of_others, flags)
    room = rooms(paths, foot, centers, fails, 0.5 * x.width, x.bent > 0)
    distance = -np.inf
    for i in range(n):
        way = paths[i, frames - 1, 0] - state[0]
        # A way that is not a number drops nobody.
        distance = max(distance, way) if way == way else np.inf
    near, owed = threats(others, (distance, x.perception), lanes, fails, owned, centers, paths, foot)
    if ignored.shape[0] > 0:
        kept = ~ignored[near]
        near, owed = near[kept], owed[:, kept].copy()
    around = Around(rows, states, stretch, bodies, motion_of(motion), others)
    separations, reached = np.empty((n, 0)), np.full(n, frames)
    if near.shape[0] > 0:
        plans, ground = Plans(paths, lanes, fails), Ground(centers, owned, visible)
        separations = _separations(plans, state[1], foot, ground, around, near, owed, x, hold, reached)
    slips = slipping if hold == 0 else slipping[:0]
    apart, q = _slips(paths, foot, centers, table, ignored, around, slips, x), near.shape[0]
    margin = margins(separations, apart, room)
    found, marked = np.empty((2 + q + apart.shape[1], n)), np.empty((3, n), np.intp)
    for i in range(n):
        if q == 0 and not np.isfinite(paths[i]).all():
            margin[i] = np.nan
        found[0, i], found[1, i] = margin[i], room[i]
        found[2 : 2 + q, i], found[2 + q :, i] = separations[i], apart[i]
        marked[0, i] = reached[i]
        marked[1, i], marked[2, i] = _binding(margin[i], separations[i], near, apart[i], slips)
    return found, marked, near
