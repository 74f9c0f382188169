"""The closed form of a held input and a stop is the simulator, frame by frame."""

import numpy as np
import pytest
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.state import State
from dynamics.vehicle.fixed_wheel_stops import stops

STATE = st.tuples(st.floats(-30, 30), st.floats(-20, 20), st.floats(-4, 4), st.floats(-15, 15)).map(np.array)
INPUTS = st.lists(st.tuples(st.floats(-10, 10), st.floats(-np.pi / 4, np.pi / 4)), min_size=1, max_size=4).map(np.array)
HOLD, DT, BRAKING = st.integers(1, 6), st.floats(0.02, 0.25), st.floats(0.5, 10)


def simulate(state, inputs, hold, braking, dt, period, frames):
    """highway-env's own vehicle: the input, and then a brake that looks at the speed once in a period."""
    car = Vehicle(None, state[:2].copy(), state[2], state[3])
    out = []
    for k in range(frames):
        a = inputs[0]
        if k >= hold:
            if (k - hold) % period == 0:
                brake = float(np.clip(-car.speed / (period * dt), -braking, braking))
            a = brake
        car.act({"acceleration": a, "steering": inputs[1]})
        car.step(dt)
        out.append([*car.position, car.heading, car.speed])
    return np.array(out)


@settings(deadline=None)
@given(STATE, INPUTS, HOLD, BRAKING, DT, st.integers(1, 5))
def test_the_closed_form_of_a_stop_equals_the_simulator(state, inputs, hold, braking, dt, period):
    paths = stops(state, inputs, hold, braking, dt, period)
    assert paths.shape[0] == len(inputs)
    assert (paths.shape[1] - hold) % period == 0
    for path, one in zip(paths, inputs, strict=True):
        assert path == pytest.approx(simulate(state, one, hold, braking, dt, period, len(path)), abs=1e-9)


@settings(deadline=None)
@given(STATE, INPUTS, HOLD, BRAKING, DT, st.integers(1, 5))
def test_a_stop_ends_at_rest_and_never_reverses(state, inputs, hold, braking, dt, period):
    speed = stops(state, inputs, hold, braking, dt, period)[:, hold - 1 :, State.SPEED]
    assert (speed[:, -1] == 0).all()
    assert (np.diff(np.abs(speed), axis=1) <= 1e-12).all()
    assert (speed * speed[:, :1] >= 0).all()


@given(STATE, INPUTS, HOLD, BRAKING, DT)
def test_the_remainder_of_a_stop_stays_on_the_predicted_path(state, inputs, hold, braking, dt):
    """Recursive feasibility: one more period of braking with the same wheel stays on the path."""
    path = stops(state, inputs[:1], hold, braking, dt, hold)[0]
    if len(path) == hold:
        return
    brake = np.clip(-path[hold - 1, State.SPEED] / (hold * dt), -braking, braking)
    again = stops(path[hold - 1], np.array([[brake, inputs[0, 1]]]), hold, braking, dt, hold)[0]
    n = min(len(again), len(path) - hold)
    assert again[:n] == pytest.approx(path[hold : hold + n], abs=1e-9)
    assert again[n:] == pytest.approx(np.broadcast_to(path[-1], again[n:].shape), abs=1e-9)


def test_the_wheel_base_is_the_vehicles():
    state, inputs = np.array([0.0, 0, 0, 2.0]), np.array([[0.0, 0.3]])
    long, short = (stops(state, inputs, 1, 5.0, 0.1, length=n)[0, 0, State.HEADING] for n in (10.0, 5.0))
    assert short == pytest.approx(2 * long)
