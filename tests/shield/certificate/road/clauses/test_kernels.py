"""The compiled loops against the same quantities as whole arrays, and their results for values that are not finite."""

from __future__ import annotations

import math

import numpy as np
import pytest
from highway_env.utils import are_polygons_intersecting
from highway_env.vehicle.kinematics import Vehicle as Simulated
from hypothesis import given
from hypothesis import strategies as st

from dynamics.compiled import compiled
from shield.certificate.road.clauses.clause_inputs import LaneDistances, LaneState, PlannedPath
from shield.certificate.road.clauses.edge import lanes_touched, verdicts
from shield.certificate.road.clauses.entering import (
    LateralExtents,
    joins,
    lateral_extents,
    leaves_sight,
    mark_entrants,
    neighbours,
)
from shield.certificate.road.clauses.followers import updated_lanes
from shield.certificate.road.clauses.footprint import Footprint
from shield.certificate.road.clauses.others import RoadVehicles
from shield.certificate.road.clauses.separation import (
    FollowerResponse,
    UnobligatedVehicle,
    coming_frame,
    extents,
    separation,
    turns,
)
from shield.certificate.road.clauses.stopping_room import margin_of

CENTERS = np.array([0.0, 4.0, 8.0])
SIZE = Footprint(4.5, 1.3, 5.0, 2.0, 0.1, 0.05, 0.02, 0.01)
DT = 0.1
DUTY = FollowerResponse(3.0, 4, 6.0, 5.0, 40.0, 75.0, 0, DT)
seeds = st.integers(0, 2**32 - 1)


def drives(rng, n, frames):
    """Paths that sway across the road and slow down, (n, frames, 4)."""
    paths = np.empty((n, frames, 4))
    v = np.maximum(rng.uniform(0, 35, (n, 1)) - rng.uniform(0, 9, (n, 1)) * DT * np.arange(frames), 0.0)
    paths[..., 0], paths[..., 3] = np.cumsum(v, axis=1) * DT, v
    paths[..., 1] = rng.uniform(-1, 9, (n, 1)) + rng.uniform(-3, 3, (n, 1)) * np.linspace(0, 1, frames)
    paths[..., 2] = rng.uniform(-0.3, 0.3, (n, 1)) * np.linspace(1, 0, frames) * rng.choice([0.0, 1.0], (n, 1))
    return paths


def traffic(rng, n, m, frames):
    low = rng.uniform(-2, 8, (rng.choice([1, n]), m))
    start = rng.uniform(-60, 60, m)
    rear = start[:, None] + np.cumsum(np.maximum(rng.uniform(0, 30, (m, 1)) - 0.6 * np.arange(frames), 0), axis=1) * DT
    return {
        "low": low,
        "high": low + rng.uniform(2, 6, low.shape),
        "rear": rear,
        "lengths": np.full(m, 2.7),
        "follows": rng.random(m) < 0.5,
        "centers": CENTERS[rng.integers(0, 3, low.shape)],
        "at_once": rng.integers(-1, 4, low.shape),
        "followers": np.stack([rng.uniform(0, 35, m), start + 2.5, rng.uniform(0.9, 1.1, m)]),
    }


@compiled
def separation_of(path, size, other, rear, duty):
    """Of a path from one vehicle; NaN and 0 where the path is not finite."""
    frames = path.shape[0]
    turned, bounds = np.empty((2, frames)), np.empty((5, frames))
    turns(path, turned)
    ego = extents(path, turned, size, (0.0, duty.dt), bounds)
    plan = PlannedPath(path, turned, 0, 0)
    return separation(plan, ego, bounds, size, other, rear, duty) if ego.finite else (np.nan, 0)


def separations_of(paths, t):
    n, m = len(paths), len(t["rear"])
    out, reached = np.empty((n, m)), np.full(n, paths.shape[1])
    for i in range(n):
        at = i if len(t["low"]) > 1 else 0
        for j in range(m):
            sides = float(t["low"][at, j]), float(t["high"][at, j])
            duties = bool(t["follows"][j]), float(t["centers"][at, j]), int(t["at_once"][at, j])
            other = UnobligatedVehicle(
                *sides, *sides, paths.shape[1], t["lengths"][j], 0.0, *duties, *t["followers"][:, j]
            )
            out[i, j], first = separation_of(paths[i], SIZE, other, t["rear"][j], DUTY)
            reached[i] = min(reached[i], first)
    return out, reached


def front_of(path, center, at_once, v0, start, stretch):
    seen, reaction, gain, loss, most = DUTY[:5]
    frames, rests = len(path), path[-1, 3] < 0.5
    hidden = np.abs(path[:, 1] - center) > seen
    first = int(np.flatnonzero(hidden)[-1]) + 2 if hidden.any() else 1
    turn = at_once if first == 1 and at_once >= 0 else first + reaction
    # Long enough for it to come to rest as well.
    k = np.arange(frames + turn + 400) if rests else np.arange(frames)
    top = np.full(len(k), v0)
    for i in range(1, len(k)):
        more = min(gain, DUTY.power / max(top[i - 1], 1e-3)) * DT if i <= turn else 0.0
        top[i] = min(top[i - 1] + more, max(v0, most))
    v = np.maximum(top - loss * DT * np.maximum(k - turn, 0), 0.0)
    way = np.cumsum(v) * DT
    if rests:
        way[frames - 1] = way[-1]
    return start + way[:frames] * stretch


def expected(paths, t):
    """Whole arrays for one pair at a time: the formulas of `shield.certificate.road.verify`."""
    n, frames, _ = paths.shape
    out, bad = np.full((n, len(t["rear"])), np.inf), np.full(n, frames)
    for i, path in enumerate(paths):
        s, r, psi, _ = path.T
        sin, cos = np.abs(np.sin(psi)), np.abs(np.cos(psi))
        half_s, half_r = SIZE[0] * cos + SIZE[1] * sin + SIZE[4], SIZE[0] * sin + SIZE[1] * cos + SIZE[5]
        for j in range(len(t["rear"])):
            at = i if len(t["low"]) > 1 else 0
            low, high = t["low"][at, j], t["high"][at, j]
            beside = max(low - (r + half_r).max(), (r - half_r).min() - high)
            if beside >= 0:
                out[i, j] = beside
                continue
            front = np.full(frames, np.inf)
            if t["follows"][j]:
                front = front_of(path, t["centers"][at, j], t["at_once"][at, j], *t["followers"][:, j])
            along = np.maximum(t["rear"][j] - (s + half_s), (s - half_s) - front)
            apart = np.maximum(along, np.maximum(low - (r + half_r), (r - half_r) - high))
            out[i, j] = apart.min()
            if out[i, j] < 0:
                bad[i] = min(bad[i], int((apart < 0).argmax()))
    return out, bad


@given(seeds, st.integers(1, 5), st.integers(1, 6), st.integers(1, 30))
def test_separations_are_those_of_whole_arrays(seed, n, m, frames):
    rng = np.random.default_rng(seed)
    paths, t = drives(rng, n, frames), traffic(rng, n, m, frames)
    paths[..., 2] *= 0.02  # along the road; the effect of a heading is tested against the simulator below
    got, wanted = separations_of(paths, t), expected(paths, t)
    np.testing.assert_allclose(got[0], wanted[0], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(got[1], wanted[1])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("column", range(4))
def test_a_path_that_is_not_finite_has_no_separation(value, column):
    rng = np.random.default_rng(0)
    paths, t = drives(rng, 2, 5), traffic(rng, 2, 3, 5)
    paths[1, 3, column] = value
    got, reached = separations_of(paths, t)
    assert np.isnan(got[1]).all()
    assert reached[1] == 0
    assert not np.isnan(got[0]).any()


@pytest.mark.parametrize("name", ["low", "high", "rear"])
def test_an_absent_vehicle_has_no_separation(name):
    rng = np.random.default_rng(1)
    paths, t = drives(rng, 2, 5), traffic(rng, 2, 3, 5)
    t["follows"] = np.zeros(3, dtype=bool)
    t[name][(1, slice(2, None)) if name == "rear" else (slice(None), 1)] = np.nan
    got, _ = separations_of(paths, t)
    assert np.isnan(got[:, 1]).all()
    assert not np.isnan(got[:, [0, 2]]).any()


@given(seeds, st.integers(1, 5), st.integers(2, 30))
def test_lanes_touched_are_those_of_whole_arrays(seed, n, frames):
    rng = np.random.default_rng(seed)
    paths, fails, owned = drives(rng, n, frames), rng.integers(0, 3, n), rng.random(3) < 0.4
    state, body = paths[0, 0].copy(), (5.0, 2.0, 0.1)
    state[1] += rng.uniform(-1, 1)
    entered, edges, allowed, on_road = lanes_touched(state, paths, body, CENTERS, 2.0, owned, fails)
    paths = np.concatenate([np.repeat(state[None, None], n, axis=0), paths], axis=1)
    half = 0.5 * (5 * np.abs(np.sin(paths[..., 2])) + 2 * np.abs(np.cos(paths[..., 2]))) + 0.1
    low, high = paths[..., 1] - half, paths[..., 1] + half
    touches, inside = ((low[..., None] < CENTERS + side) & (high[..., None] > CENTERS - side) for side in (2.0, 1.0))
    comes, returns = (touches & ~(np.roll(touches, 1, 1) & owned))[:, 1:], (inside[:, 1:] & ~inside[:, :-1])
    new = comes.any(1) | returns.any(1)
    new[np.arange(n), fails] = False
    low, high = low[:, 1:], high[:, 1:]
    np.testing.assert_array_equal(entered, np.where(new.any(1), new.argmax(1), fails))
    np.testing.assert_allclose(edges, np.stack([low.min(1) + 2, 10 - high.max(1)], 1), atol=1e-12)
    np.testing.assert_array_equal(allowed, new.sum(1) <= 1)
    off = (low < -2) | (high > 10)
    np.testing.assert_array_equal(on_road, np.where(off.any(1), off.argmax(1), frames))


def test_a_lane_is_owned_from_the_stored_plan_on_until_the_ego_has_left_it():
    nobody = np.zeros((0, 0), dtype=bool)
    none = np.zeros(0, dtype=bool)
    near = LaneDistances(3.0, 2.1, 3.1)
    marks = LaneState(CENTERS, none, np.zeros(3, dtype=np.intp))
    visible, owned, _ = updated_lanes(0.1, 1, near, -1, marks, none, nobody)
    assert list(owned) == [True, False, False]
    assert list(visible) == [1, 0, 0]
    _, owned, _ = updated_lanes(1.5, 1, near, 1, LaneState(CENTERS, owned, visible), none, nobody)
    assert list(owned) == [True, False, False]  # the stored plan stops in lane 1, which is not touched yet
    visible, owned, _ = updated_lanes(2.0, 2, near, 1, LaneState(CENTERS, owned, visible), none, nobody)
    assert list(owned) == [True, True, False]
    assert list(visible) == [3, 2, 0]
    _, owned, _ = updated_lanes(3.0, 1, near, 1, LaneState(CENTERS, owned, visible), none, nobody)
    assert list(owned) == [True, True, False]  # a corner of it is in lane 0 still
    for stored in (0, 1):
        _, last, _ = updated_lanes(3.9, 1, near, stored, LaneState(CENTERS, owned, visible), none, nobody)
        assert list(last) == [stored == 0, True, False]  # a plan to stop there keeps it


def others_at(lanes, ahead, across=0.0, r=None, gains=True):
    """Vehicles in the middle of their lanes, and which lanes they may enter."""
    m, lanes = len(lanes), np.asarray(lanes)
    ahead = np.asarray(ahead, float)
    zero, nobody, nowhere = np.zeros(m), np.zeros(m, dtype=bool), np.zeros((3, m), dtype=bool)
    where = CENTERS[lanes] if r is None else np.asarray(r, float)
    sides = where - 1.25, where + 1.25
    bodies = ahead, ahead, zero + 7, nobody, *sides, lanes, where, zero + across
    others = RoadVehicles(*bodies, nobody, nowhere, nowhere.copy())
    return entering(others, np.full((m, 2), gains))


def entering(others, gains, before=None, visible=(0, 0, 0), stored=-1, entered=-1):
    """The same, with the vehicles that may enter each lane, after those of the scene before."""
    before = np.zeros((0, 0), dtype=bool) if before is None else before
    beside, comes = np.zeros_like(others.beside), np.zeros_like(others.comes)
    others = others._replace(beside=beside, comes=comes)
    asked = np.empty_like(gains)
    plan = (stored, entered)
    neighbours(others, CENTERS, 4.0, before, np.array(visible), plan, asked)
    lanes = LaneState(CENTERS, np.zeros(3, dtype=bool), np.array(visible))
    mark_entrants(others, gains & asked, lanes, before, plan, 3, 30)
    return others


def sides(path, lane, fail, others, r=0.0):
    m = len(others.lane)
    low, high, home = np.empty(m), np.empty(m), np.empty(m, dtype=np.intp)
    out = LateralExtents(low, high, home)
    lateral_extents((lane, fail), np.arange(m), others, np.full(m, 2.0), CENTERS, 0.25, out)
    for entered in (lane, fail):
        if leaves_sight(r, path[0], CENTERS[entered], 3.0) < path.shape[1]:
            for j in range(m):
                joined = joins(others.low[j], others.high[j], CENTERS[entered], 1.25, 4.0)
                low[j], high[j] = min(low[j], joined[0]), max(high[j], joined[1])
    return low, high, home


def test_vehicles_beside_a_lane_may_enter_it_until_the_ego_is_visible_there():
    path = np.zeros((1, 9, 4))
    path[0, :, 1] = np.linspace(0.3, 4.0, 9)
    others = others_at([2, 2, 0, 1], [20.0, -20.0, 20.0, 30.0])
    for fail in (0, 1):
        low, high, home = sides(path, 1, fail, others)
        np.testing.assert_allclose(low[:3], [2.75, 2.75, -1.25])
        np.testing.assert_allclose(high[:3], [9.25, 9.25, 5.25])
        assert list(home[:2]) == [1, 1]
        np.testing.assert_allclose((low[3], high[3]), ((2.75, 5.25) if fail == 1 else (-1.25, 5.25)))
    others = others_at([2, 2, 0, 1], [20.0, -20.0, 20.0, 30.0], gains=False)
    np.testing.assert_allclose(sides(path, 1, 1, others)[0], [6.75, 6.75, -1.25, 2.75])


@pytest.mark.parametrize(("across", "r", "visible", "comes"), [
    (0.0, 8.0, 3, True),  # it may have begun just before it could see the ego
    (0.0, 8.0, 4, False),
    (-1.0, 8.0, 4, True),  # it was on its way before
    (-1.0, 8.0, 29, True),
    (-1.0, 8.0, 30, False),  # no vehicle is visible for that long
    (-1.0, 8.8, 4, False),  # it settles in the middle of its own lane
])  # fmt: skip
def test_a_vehicle_may_enter_a_lane_with_a_visible_ego_only_if_it_was_on_its_way(across, r, visible, comes):
    path = np.zeros((1, 9, 4))
    path[0, :, 1] = 4.0
    first, gains = others_at([2], [10.0], across, [r]), np.ones((1, 2), dtype=bool)
    seen = [0, visible, 0]
    low, _, _ = sides(path, 1, 1, entering(first, gains, first.comes, seen, 1), r=4.0)
    assert (low[0] < 3.0) == comes
    assert not entering(first, gains, np.zeros_like(first.comes), seen, 1).comes[1].any()


@given(seeds)
def test_bodies_apart_in_the_coming_frame_do_not_collide_in_the_simulator(seed):
    """For any heading of the other vehicle: where the clause refuses nothing, highway-env counts no coming
    collision."""
    rng = np.random.default_rng(seed)
    dt, size = rng.choice([0.2, 1 / 15]), Footprint(4.5, 1.3, 5.0, 2.0)
    ego, other = Simulated(None, [0, 0], rng.normal(0, 0.2), rng.uniform(0, 35)), None
    length, width = rng.choice([(5.0, 2.0), (12.0, 2.5), (2.0, 0.8)])
    other = Simulated(None, [rng.uniform(-14, 14), rng.uniform(-6, 6)], rng.normal(0, 0.2), rng.uniform(0, 35))
    other.LENGTH, other.WIDTH = length, width
    corners, move = other.polygon(), other.velocity * dt
    s, r = np.concatenate([corners, corners + move]).T
    slack = rng.uniform(0, 1, 4)
    ends = corners[:, 0].min() - slack[0], corners[:, 0].min() - slack[0] + max(move[0] - slack[1], 0)
    ends += corners[:, 0].max() + slack[2], s.max() + slack[2] + slack[3]
    state = np.array([0.0, 0.0, ego.heading, ego.speed])
    turned = math.sin(ego.heading), math.cos(ego.heading)
    apart = coming_frame(state, turned, size, ends, (r.min(), r.max()), 0.5 * np.hypot(length, width), dt)
    _, will, _ = are_polygons_intersecting(ego.polygon(), corners, ego.velocity * dt, move)
    assert apart == np.inf or apart < 0
    if apart == np.inf:
        assert not will


def with_holes(rng, *shape):
    """Numbers of both signs, some infinite, some NaN."""
    out = rng.normal(size=shape)
    out[rng.random(shape) < 0.1] = np.nan
    out[rng.random(shape) < 0.1] = np.inf
    return out


@given(seeds, st.integers(1, 5), st.integers(0, 4), st.integers(0, 3))
def test_margins_are_those_of_whole_arrays(seed, n, m, slipping):
    rng = np.random.default_rng(seed)
    separations, slips, room = with_holes(rng, n, m), with_holes(rng, n, slipping), with_holes(rng, n)
    inside = np.where(room >= 0, np.inf, room)[:, None]
    least = np.hstack([separations, slips, inside]).min(axis=1)
    got = [margin_of(*parts) for parts in zip(separations, slips, room, strict=True)]
    np.testing.assert_array_equal(got, least)
    edges, allowed, paths = with_holes(rng, n, 2), rng.random(n) < 0.7, rng.normal(size=(n, 3, 4))
    lacks = np.where(edges.min(axis=1) >= 0, np.inf, edges.min(axis=1))
    may = allowed & (paths[:, 1, 3] >= -1e-9)
    np.testing.assert_array_equal(
        verdicts(least, edges, allowed, paths, 2), np.where(may, np.minimum(least, lacks), -np.inf)
    )


def test_an_absent_vehicle_stays_absent():
    others = others_at([1], [np.nan], r=[np.nan])
    low, high, _ = sides(drives(np.random.default_rng(0), 1, 5), 1, 1, others)
    assert np.isnan(low).all()
    assert np.isnan(high).all()
