"""Occupancy contains every behaviour that the assumptions allow."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.errors import ConfigError
from dynamics.roads.straight import StraightRoad
from dynamics.traffic.assumptions import Assumptions
from dynamics.traffic.occupancy import Surroundings, constant_velocity, predict_occupancy

LIMITS = settings(deadline=None, max_examples=150, derandomize=True)
ROAD = StraightRoad.from_lanes(4)
FRAMES = 40
seeds = st.integers(0, 2**32 - 1)
profiles = st.sampled_from([Assumptions.idm(), Assumptions.rss(), Assumptions(min_speed=15.0)])
rates = st.sampled_from([1 / 5, 1 / 15])


def rows_of(states, crashed=0.0):
    states = np.atleast_2d(states).astype(float)
    return np.column_stack([states, np.tile([5.0, 2.0, crashed], (len(states), 1))])


def drive(state, assumptions, dt, rng, heading):
    """One random behaviour: accelerations within the bounds, often the bounds themselves; yields (s, speed)."""
    s, v = float(state[0]), float(state[3])
    low, high = -assumptions.braking, assumptions.acceleration
    pure = rng.integers(3)
    for _ in range(FRAMES):
        s += v * np.cos(heading()) * dt
        a = [low, high, rng.uniform(low, high)][pure if rng.random() < 0.7 else rng.integers(3)]
        top, floor = max(v, assumptions.max_speed), min(v, assumptions.min_speed)
        v = min(max(v + a * dt, floor), top)
        yield s, v


@LIMITS
@given(seeds, profiles, rates, st.floats(0, 45), st.floats(-0.39, 0.39), st.floats(-0.04, 0.04), st.integers(0, 3))
def test_a_lane_keeper_stays_inside(seed, assumptions, dt, speed, offset, psi, lane):
    rng = np.random.default_rng(seed)
    centre = ROAD.centers[lane]
    state = np.array([rng.uniform(0, 500), centre + offset, psi, speed])
    occ = predict_occupancy(rows_of(state), state[None], ROAD, assumptions, FRAMES, dt)
    bound = abs(psi)
    headings = []

    def heading():
        headings.append(rng.uniform(-bound, bound))
        return headings[-1]

    for k, (s, _) in enumerate(drive(state, assumptions, dt, rng, heading)):
        h = abs(headings[-1])
        half_s = 2.5 * np.cos(h) + np.sin(h)
        half_r = np.cos(h) + 2.5 * np.sin(h)
        r = centre + offset * rng.random()
        assert occ.rear[0, k] - 1e-9 <= s - half_s
        assert s + half_s <= occ.front[0, k] + 1e-9
        assert occ.low[0] - 1e-9 <= r - half_r
        assert r + half_r <= occ.high[0] + 1e-9


@LIMITS
@given(seeds, profiles, rates, st.floats(0.5, 45), st.floats(-2, 2), st.floats(-0.35, 0.35), st.integers(0, 3))
def test_a_vehicle_that_changes_lanes_or_aborts_stays_inside(seed, assumptions, dt, speed, offset, psi, lane):
    rng = np.random.default_rng(seed)
    state = np.array([rng.uniform(0, 500), ROAD.centers[lane] + offset, psi, speed])
    rows = rows_of(state)
    occ = predict_occupancy(rows, state[None], ROAD, assumptions, FRAMES, dt)
    around = Surroundings(rows, state[None], ROAD, assumptions)
    bound = assumptions.max_heading if around.moving[0] else abs(psi)
    headings = [psi]

    def heading():
        headings.append(rng.uniform(-bound, bound))
        return headings[-2]

    assert abs(ROAD.centers[around.lane[0]] - state[1]) <= 2 + 1e-9
    for k, (s, _) in enumerate(drive(state, assumptions, dt, rng, heading)):
        h = abs(headings[-1])
        half_s = 2.5 * np.cos(h) + np.sin(h)
        assert occ.rear[0, k] - 1e-9 <= s - half_s
        assert s + half_s <= occ.front[0, k] + 1e-9
    width = np.cos(abs(psi)) + 2.5 * np.sin(abs(psi))
    assert occ.low[0] - 1e-9 <= state[1] - width
    assert state[1] + width <= occ.high[0] + 1e-9


def test_one_that_turns_may_be_in_either_lane_and_one_that_keeps_only_in_its_own():
    states = np.array([[0, 4.0, 0.0, 25.0], [0, 4.5, 0.1, 25.0], [0, 4.5, -0.1, 25.0], [0, 12.5, 0.1, 25.0]])
    around = Surroundings(rows_of(states), states, ROAD, Assumptions.idm())
    low, high = around.low, around.high
    assert list(around.lane) == [1, 1, 1, 3]
    assert list(around.moving) == [False, True, True, True]
    assert 2.8 < low[0] < 3.0
    assert 5.0 < high[0] < 5.2
    assert high[1] > 9.0 > low[1]  # on its way to lane 2
    assert high[2] < 7.0  # on its way back to the centre of lane 1
    assert high[3] < 15.0  # there is no lane 4


@LIMITS
@given(st.floats(0, 45), rates)
def test_a_wreck_is_contained(speed, dt):
    state = np.array([100.0, 4.0, 0.0, speed])
    occ = predict_occupancy(rows_of(state, crashed=1.0), state[None], ROAD, Assumptions.idm(), FRAMES, dt)
    s, v = 100.0, speed
    for k in range(FRAMES):
        s += v * dt
        v += -1.0 * v * dt
        assert occ.rear[0, k] - 1e-9 <= s - 2.5
        assert s + 2.5 <= occ.front[0, k] + 1e-9


def test_a_standing_vehicle_may_start_but_not_reverse():
    state = np.array([[50.0, 4.0, 0.0, 0.0]])
    occ = predict_occupancy(rows_of(state), state, ROAD, Assumptions.idm(), FRAMES, 0.2)
    np.testing.assert_array_equal(occ.rear[0], occ.rear[0, 0])
    assert (np.diff(occ.front[0]) > 0).all()


def test_worse_assumptions_give_larger_occupancy():
    state = np.array([[50.0, 4.0, 0.0, 25.0]])
    idm = predict_occupancy(rows_of(state), state, ROAD, Assumptions.idm(), FRAMES, 0.2)
    rss = predict_occupancy(rows_of(state), state, ROAD, Assumptions.rss(), FRAMES, 0.2)
    assert (rss.rear <= idm.rear).all()
    assert (rss.front >= idm.front).all()


def test_holding_back_the_worst_case_gives_a_smaller_occupancy():
    state = np.array([[50.0, 4.0, 0.0, 25.0]])
    bound = predict_occupancy(rows_of(state), state, ROAD, Assumptions.idm(), FRAMES, 0.2)
    forecast = predict_occupancy(rows_of(state), state, ROAD, Assumptions.idm(), FRAMES, 0.2, hold=10)
    assert (forecast.rear >= bound.rear).all()
    assert (forecast.front <= bound.front).all()
    np.testing.assert_allclose(np.diff(forecast.rear[0, :10]), 5.0 * np.cos(0.0), atol=1e-2)


def test_rectangles_are_ordered_frame_by_frame():
    states = np.array([[50.0, 4.0, 0.0, 25.0], [80.0, 8.0, 0.1, 20.0]])
    rectangles = predict_occupancy(rows_of(states), states, ROAD, Assumptions.idm(), 7, 0.2).rectangles()
    assert rectangles.shape == (7, 2, 4)
    assert (rectangles[..., 0] < rectangles[..., 1]).all()
    assert (rectangles[..., 2] < rectangles[..., 3]).all()


@LIMITS
@given(st.floats(-40, 40), st.floats(-3, 3), rates)
def test_constant_velocity_is_euler_with_nothing_done(speed, heading, dt):
    state = np.array([[1.0, 2.0, heading, speed]])
    path = constant_velocity(state, 10, dt)
    assert path.shape == (1, 10, 4)
    s, r = 1.0, 2.0
    for k in range(10):
        s, r = s + speed * np.cos(heading) * dt, r + speed * np.sin(heading) * dt
        np.testing.assert_allclose(path[0, k], [s, r, heading, speed], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(state, [[1.0, 2.0, heading, speed]])


@pytest.mark.parametrize(
    "changes",
    [
        {"braking": 0.0},
        {"braking": -6.0},
        {"follower_braking": 0.0},
        {"acceleration": float("nan")},
        {"reaction_time": float("inf")},
        {"max_speed": "fast"},
        {"braking": True},
        {"blind_merge": 1},
        {"min_speed": 50.0},
    ],
)
def test_impossible_assumptions_are_refused(changes):
    with pytest.raises(ConfigError, match="Assumptions"):
        Assumptions(**changes)
