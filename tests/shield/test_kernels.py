"""The compiled loops against the same quantities as whole arrays, and what they say of numbers that are none."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shield.certificate.kernels import (
    lanes_held,
    lanes_touched,
    least_separations,
    margins,
    may_break,
    sides_taken,
    verdicts,
)

CENTERS = np.array([0.0, 4.0, 8.0])
SIZE = np.array([4.5, 1.3, 5.0, 2.0, 0.1, 0.05, 0.02, 0.01])
DT = 0.1
DUTY = np.array([3.0, 4.0, 6.0, 5.0, 40.0, 0.0, DT])
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
    owed = rng.random((n, m)) < 0.3
    return {
        "low": low,
        "high": low + rng.uniform(2, 6, low.shape),
        "rear": rear,
        "owed": owed if rng.random() < 0.7 else np.zeros((0, 0), dtype=bool),
        "follows": rng.random(m) < 0.5,
        "centers": CENTERS[rng.integers(0, 3, low.shape)],
        "at_once": rng.integers(-1, 4, low.shape),
        "followers": np.stack([rng.uniform(0, 35, m), start + 2.5, rng.uniform(0.9, 1.1, m)]),
    }


def separations_of(paths, t):
    out, reached = np.empty((len(paths), len(t["rear"]))), np.empty(len(paths), dtype=np.intp)
    least_separations(paths, SIZE, *t.values(), DUTY, out, reached)
    return out, reached


def front_of(path, center, at_once, v0, start, stretch):
    seen, reaction, gain, loss, most = DUTY[:5]
    frames = len(path)
    hidden = np.abs(path[:, 1] - center) > seen
    first = int(np.flatnonzero(hidden)[-1]) + 2 if hidden.any() else 1
    turn = at_once if first == 1 and at_once >= 0 else first + reaction
    k = np.arange(frames)
    top = np.minimum(v0 + gain * DT * np.minimum(k, turn), max(v0, most))
    v = np.maximum(top - loss * DT * np.maximum(k - turn, 0), 0.0)
    way = np.cumsum(v) * DT
    if path[-1, 3] < 0.5:
        way[-1] += v[-1] ** 2 / (2 * loss) + 0.5 * v[-1] * DT
    return start + way * stretch


def expected(paths, t):
    """Whole arrays for one pair at a time: the formulas of `shield.certificate.verify`."""
    n, frames, _ = paths.shape
    out, bad = np.full((n, len(t["rear"])), np.inf), np.full(n, frames)
    for i, path in enumerate(paths):
        s, r, psi, v = path.T
        sin, cos = np.abs(np.sin(psi)), np.abs(np.cos(psi))
        boxes = [(s, r, SIZE[0] * cos + SIZE[1] * sin + SIZE[4], SIZE[0] * sin + SIZE[1] * cos + SIZE[5])]
        body = 0.5 * (SIZE[2] * cos + SIZE[3] * sin) + SIZE[6], 0.5 * (SIZE[2] * sin + SIZE[3] * cos) + SIZE[7]
        boxes.append((s + v * np.cos(psi) * DT, r + v * np.sin(psi) * DT, *body))
        for j in range(len(t["rear"])):
            if t["owed"].size and t["owed"][i, j]:
                continue
            at = i if len(t["low"]) > 1 else 0
            apart = []
            front = np.full(frames, np.inf)
            if t["follows"][j]:
                front = front_of(path, t["centers"][at, j], t["at_once"][at, j], *t["followers"][:, j])
            for ahead, (x, y, half_s, half_r) in enumerate(boxes):
                later = np.minimum(np.arange(frames) + ahead, frames - 1)
                along = np.maximum(t["rear"][j][later] - (x + half_s), (x - half_s) - front[later])
                across = np.maximum(t["low"][at, j] - (y + half_r), (y - half_r) - t["high"][at, j])
                apart.append(np.maximum(along, across))
            if (sin >= 0.01).any():
                hit = (apart[1] < 0) & (np.arange(frames) < frames - 1)
                apart[0] = np.where(hit, np.minimum(apart[0], apart[1]), apart[0])
            out[i, j] = apart[0].min()
            if out[i, j] < 0:
                bad[i] = min(bad[i], int((apart[0] < 0).argmax()))
    return out, bad


@given(seeds, st.integers(1, 5), st.integers(1, 6), st.integers(1, 30))
def test_separations_are_those_of_whole_arrays(seed, n, m, frames):
    rng = np.random.default_rng(seed)
    paths, t = drives(rng, n, frames), traffic(rng, n, m, frames)
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
def test_a_vehicle_that_is_nowhere_has_no_separation(name):
    rng = np.random.default_rng(1)
    paths, t = drives(rng, 2, 5), traffic(rng, 2, 3, 5)
    t["owed"], t["follows"] = np.zeros((0, 0), dtype=bool), np.zeros(3, dtype=bool)
    t[name][(1, slice(2, None)) if name == "rear" else (slice(None), 1)] = np.nan
    got, _ = separations_of(paths, t)
    assert np.isnan(got[:, 1]).all()
    assert not np.isnan(got[:, [0, 2]]).any()


@given(seeds, st.integers(1, 5), st.integers(2, 30))
def test_lanes_touched_are_those_of_whole_arrays(seed, n, frames):
    rng = np.random.default_rng(seed)
    paths, fails, owned = drives(rng, n, frames), rng.integers(0, 3, n), rng.random(3) < 0.4
    entered, edges, allowed, on_road = lanes_touched(paths, 5.0, 2.0, 0.1, CENTERS, 2.0, owned, fails)
    half = 0.5 * (5 * np.abs(np.sin(paths[..., 2])) + 2 * np.abs(np.cos(paths[..., 2]))) + 0.1
    low, high = paths[..., 1] - half, paths[..., 1] + half
    new = (high.max(1)[:, None] > CENTERS - 2) & (low.min(1)[:, None] < CENTERS + 2) & ~owned
    new[np.arange(n), fails] = False
    np.testing.assert_array_equal(entered, np.where(new.any(1), new.argmax(1), fails))
    np.testing.assert_allclose(edges, np.stack([low.min(1) + 2, 10 - high.max(1)], 1), atol=1e-12)
    inside = (low[..., None] < CENTERS[owned] + 1) & (high[..., None] > CENTERS[owned] - 1)
    returns = (inside[:, 1:] & ~inside[:, :-1]).any((1, 2))
    np.testing.assert_array_equal(allowed, ~((new.sum(1) > 1) | returns))
    off = (low < -2) | (high > 10)
    np.testing.assert_array_equal(on_road, np.where(off.any(1), off.argmax(1), frames))


def test_a_lane_is_owned_from_the_stored_plan_on_until_the_ego_has_left_it():
    visible, owned = lanes_held(0.1, CENTERS, 1, 3.0, 2.1, -1, np.zeros(3, dtype=np.intp), np.zeros(0, dtype=bool))
    assert list(owned) == [True, False, False]
    assert list(visible) == [1, 0, 0]
    _, owned = lanes_held(1.5, CENTERS, 1, 3.0, 2.1, 1, visible, owned)
    assert list(owned) == [True, False, False]  # the stored plan stops in lane 1, which is not touched yet
    visible, owned = lanes_held(2.0, CENTERS, 2, 3.0, 2.1, 1, visible, owned)
    assert list(owned) == [True, True, False]
    assert list(visible) == [3, 2, 0]
    _, owned = lanes_held(3.9, CENTERS, 1, 3.0, 2.1, 1, visible, owned)
    assert list(owned) == [False, True, False]


@given(seeds, st.integers(1, 5), st.integers(1, 6), st.integers(2, 30), st.booleans())
def test_sides_taken_are_those_of_whole_arrays(seed, n, m, frames, announced):
    rng = np.random.default_rng(seed)
    paths, lanes, fails = drives(rng, n, frames), rng.integers(0, 3, n), rng.integers(0, 3, n)
    vehicles, rows = np.full((m + 2, 7), 2.0), rng.permutation(m + 2)[:m]
    homes, ahead, r = rng.integers(0, 3, m + 2), rng.uniform(-5, 5, m + 2), float(rng.uniform(-1, 9))
    hulls = CENTERS[homes] + np.array([[-1.0], [1.0]]) * rng.uniform(1, 3, m + 2)
    low, high, home = np.empty((n, m)), np.empty((n, m)), np.empty((n, m), dtype=np.intp)
    settings = np.array([r, 3.0, 4.0, 1.0])
    sides_taken(paths, lanes, fails, rows, hulls, homes, vehicles, ahead, CENTERS, settings, announced, low, high, home)
    left, right, taken = hulls[0, rows][None], hulls[1, rows][None], homes[rows][None]
    for entered in (lanes, fails):
        goal = CENTERS[entered][:, None]
        hidden = (np.abs(paths[..., 1] - goal).max(axis=1) > 3.0) | (np.abs(r - goal[:, 0]) > 3.0)
        apart = np.abs(CENTERS[homes[rows]] - goal)
        far = (apart > 0) & (apart < 6.0) & hidden[:, None]
        if entered is fails:
            far &= (fails != lanes)[:, None]
        elif announced:
            far &= ahead[rows] > -1.0
        left, right = np.where(far, np.minimum(left, goal - 1), left), np.where(far, np.maximum(right, goal + 1), right)
        taken = np.where(far, entered[:, None], taken)
    np.testing.assert_array_equal(low, np.broadcast_to(left, low.shape))
    np.testing.assert_array_equal(high, np.broadcast_to(right, high.shape))
    np.testing.assert_array_equal(home, np.broadcast_to(taken, home.shape))


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
    np.testing.assert_array_equal(margins(separations, slips, room), least)
    edges, allowed, paths = with_holes(rng, n, 2), rng.random(n) < 0.7, rng.normal(size=(n, 3, 4))
    lacks = np.where(edges.min(axis=1) >= 0, np.inf, edges.min(axis=1))
    may = allowed & (paths[:, 1, 3] >= -1e-9)
    np.testing.assert_array_equal(
        verdicts(least, edges, allowed, paths, 2), np.where(may, np.minimum(least, lacks), -np.inf)
    )


def test_a_vehicle_that_is_nowhere_stays_so():
    nan, none = np.full((2, 1), np.nan), np.zeros(1, dtype=np.intp)
    low, high, home = np.empty((1, 1)), np.empty((1, 1)), np.empty((1, 1), dtype=np.intp)
    path, settings = drives(np.random.default_rng(0), 1, 5), np.array([0.0, 3.0, 4.0, 1.0])
    sides_taken(path, none + 1, none, none, nan, none, nan, nan[0], CENTERS, settings, False, low, high, home)
    assert np.isnan(low).all()
    assert np.isnan(high).all()


@given(seeds)
def test_the_first_look_misses_no_change(seed):
    rng = np.random.default_rng(seed)
    before = np.zeros((3, 7))
    before[:, 3] = rng.uniform(0, 30, 3)
    rows, hull = before.copy(), np.array([[0.0, 4, 8], [2.0, 6, 10]])
    still = (rows, before, hull, hull, -5.0, 5.0, np.array([20.0, 22.0]), 0.1)
    assert not may_break(*still)
    i, kind = rng.integers(3), rng.integers(4)
    moved = hull.copy()
    if kind == 0:
        rows[i, 3] += rng.choice([-1, 1]) * rng.uniform(0.51, 3)
    elif kind == 1:
        rows[i, 6] = 1.0
    elif kind == 2:
        rows[i, 3] = np.nan
    else:
        moved[1, i] = 20.5
    assert may_break(rows, before, moved, hull, *still[4:])
