"""Occupancy contains every behaviour that the assumptions allow."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.errors import ConfigError
from dynamics.roads.straight import StraightRoad
from dynamics.traffic.assumptions import Assumptions
from dynamics.traffic.occupancy import OtherVehicles, constant_velocity

LIMITS = settings(deadline=None, max_examples=150, derandomize=True)
ROAD = StraightRoad.from_lanes(4)
FRAMES = 40
seeds = st.integers(0, 2**32 - 1)
profiles = st.sampled_from([Assumptions.idm(), Assumptions.rss(), Assumptions(min_speed=15.0)])
rates = st.sampled_from([1 / 5, 1 / 15])


def rows_of(states, crashed=0.0):
    states = np.atleast_2d(states).astype(float)
    return np.column_stack([states, np.tile([5.0, 2.0, crashed], (len(states), 1))])


def test_the_lateral_bound_of_a_vehicle_follows_from_the_lanes_that_it_touches():
    states = np.array(
        [
            [0, 4.0, 0.0, 25.0],  # in the middle of lane 1
            [0, 4.5, 0.0, 25.0],  # off it
            [0, 5.8, 0.1, 25.0],  # in two lanes, whichever way it goes
            [0, 5.8, -0.1, 25.0],
            [0, 4.0, 0.2, 25.0],  # one frame of its heading brings it over the marking
            [0, 12.5, 0.1, 25.0],  # there is no lane 4
        ]
    )
    around = OtherVehicles(rows_of(states), states, ROAD, Assumptions.idm(), 0.2)
    assert list(around.lane) == [1, 1, 1, 1, 1, 3]
    assert list(around.bodies.first) == [1, 1, 1, 1, 1, 3]
    assert list(around.bodies.last) == [1, 1, 2, 2, 2, 3]
    np.testing.assert_allclose(around.low[:5], [2.75, 2.75, 2.75, 2.75, 1.85])
    np.testing.assert_allclose(around.high[:5], [5.25, 6.15, 9.25, 9.25, 9.25])
    assert around.high[5] < 15.0


@LIMITS
@given(st.floats(0, 45), rates)
def test_a_wreck_is_contained(speed, dt):
    state = np.array([100.0, 4.0, 0.0, speed])
    occ = OtherVehicles(rows_of(state, crashed=1.0), state[None], ROAD, Assumptions.idm(), dt).occupancy(FRAMES)
    s, v = 100.0, speed
    for k in range(FRAMES):
        s += v * dt
        v += -1.0 * v * dt
        assert occ.rear[0, k] - 1e-9 <= s - 2.5
        assert s + 2.5 <= occ.front[0, k] + 1e-9


def test_a_standing_vehicle_may_start_and_reverses_only_from_a_near_standing_one():
    state = np.array([[50.0, 4.0, 0.0, 0.0]])
    occ = OtherVehicles(rows_of(state), state, ROAD, Assumptions.idm(), 0.2).occupancy(FRAMES)
    np.testing.assert_array_equal(occ.rear[0], occ.rear[0, 0])
    assert (np.diff(occ.front[0]) > 0).all()
    for ahead, speed, back in ((6.0, 0.0, 8.0), (20.0, 0.0, 0.0), (6.0, 20.0, 0.0)):
        two = np.vstack([state, state + np.array([ahead, 0, 0, speed])])
        rear = OtherVehicles(rows_of(two), two, ROAD, Assumptions.idm(), 0.2).occupancy(FRAMES).rear[0]
        assert 50.0 - 0.5 * np.hypot(5, 2) - rear[-1] == pytest.approx(back)


def test_worse_assumptions_give_larger_occupancy():
    state = np.array([[50.0, 4.0, 0.0, 25.0]])
    idm = OtherVehicles(rows_of(state), state, ROAD, Assumptions.idm(), 0.2).occupancy(FRAMES)
    rss = OtherVehicles(rows_of(state), state, ROAD, Assumptions.rss(), 0.2).occupancy(FRAMES)
    assert (rss.rear <= idm.rear).all()
    assert (rss.front >= idm.front).all()


def test_holding_back_the_worst_case_gives_a_smaller_occupancy():
    state = np.array([[50.0, 4.0, 0.0, 25.0]])
    bound = OtherVehicles(rows_of(state), state, ROAD, Assumptions.idm(), 0.2).occupancy(FRAMES)
    forecast = OtherVehicles(rows_of(state), state, ROAD, Assumptions.idm(), 0.2).occupancy(FRAMES, hold=10)
    assert (forecast.rear >= bound.rear).all()
    assert (forecast.front <= bound.front).all()
    np.testing.assert_allclose(np.diff(forecast.rear[0, :10]), 5.0 * np.cos(0.0), atol=1e-2)


def test_rectangles_are_ordered_frame_by_frame():
    states = np.array([[50.0, 4.0, 0.0, 25.0], [80.0, 8.0, 0.1, 20.0]])
    rectangles = OtherVehicles(rows_of(states), states, ROAD, Assumptions.idm(), 0.2).occupancy(7).rectangles()
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
        {"simultaneous_merge": 1},
        {"min_speed": 50.0},
    ],
)
def test_impossible_assumptions_are_refused(changes):
    with pytest.raises(ConfigError, match="Assumptions"):
        Assumptions(**changes)
