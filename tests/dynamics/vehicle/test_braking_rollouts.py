"""The held brake against the bicycle and controllers in numpy, which are checked against highway-env elsewhere."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dynamics.vehicle.bicycle import step
from dynamics.vehicle.braking_rollouts import BrakingRollouts
from dynamics.vehicle.controllers import steering_control

states = st.tuples(st.floats(-2, 6), st.floats(-0.3, 0.3), st.floats(0, 35)).map(
    lambda x: np.array([10.0, x[0], x[1], x[2]])
)


@given(
    st.lists(states, min_size=1, max_size=5), st.integers(1, 5), st.floats(1, 9.8), st.sampled_from([0.0, 0.1, 0.78])
)
def test_a_held_rollout_samples_the_braking_law_once_a_period(given_states, hold, braking, wheel):
    x0, dt, periods = np.array(given_states), 0.1, 7
    stops = np.array([[4.0 * (i % 2), braking, wheel] for i in range(len(x0))])
    got = BrakingRollouts(dt, hold).run(x0, stops, periods)
    assert got.shape == (len(x0), periods * hold, 4)
    x = x0
    for k in range(periods * hold):
        if k % hold == 0:
            a = -np.minimum(stops[:, 1], np.maximum(x[:, 3], 0) / (hold * dt))
            delta = np.clip(steering_control(x, stops[:, 0]), -stops[:, 2], stops[:, 2])
        x = step(x, a, delta, dt)
        np.testing.assert_allclose(got[:, k], x, atol=1e-9)
    assert (got[..., 3] >= -1e-9).all()


def test_enough_periods_bring_the_ego_to_rest():
    out = BrakingRollouts(0.05, 2).run(np.array([[0.0, 0.0, 0.0, 30.0]]), np.array([[0.0, 5.0, 0.7]]), 62)
    assert abs(out[0, -1, 3]) < 1e-9
