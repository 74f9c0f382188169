"""The oracle is highway-env's vehicle: frame for frame, at any speed, and however long an input is held."""

import numpy as np
import pytest
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.errors import ModelError
from dynamics.learned.models.bicycle import BicycleModel
from evaluation.settings import get_setting

numbers = st.floats(-1.2, 1.2)
states = st.tuples(st.floats(-30, 30), st.floats(-20, 20), st.floats(-3.1, 3.1), st.floats(-45, 45))


def as_state(x, y, heading, speed):
    c, s = np.cos(heading), np.sin(heading)
    return np.array([x, y, speed * c, speed * s, c, s])


@settings(max_examples=100, deadline=None)
@given(states, st.lists(st.tuples(numbers, numbers), min_size=1, max_size=4), st.integers(1, 6))
def test_rollouts_are_those_of_the_simulator(start, blocks, hold):
    model, actions = BicycleModel(), np.array(blocks)
    x, y, heading, speed = start
    vehicle = Vehicle(None, [x, y], heading, speed)
    expected = []
    for throttle, wheel in np.clip(actions, -1, 1):
        for _ in range(hold * model.frames):
            vehicle.act({"acceleration": 5 * throttle, "steering": np.pi / 4 * wheel})
            vehicle.step(model.dt)
        expected.append(as_state(*vehicle.position, vehicle.heading, vehicle.speed))
    got = model.rollout_held(as_state(*start)[None], actions[None], hold)[0]
    assert np.abs(got - np.array(expected)).max() < 1e-9


@settings(max_examples=50, deadline=None)
@given(states, st.lists(st.tuples(numbers, numbers), min_size=1, max_size=3), st.integers(1, 5))
def test_holding_is_repeating(start, blocks, hold):
    model, state, actions = BicycleModel(), as_state(*start)[None], np.array(blocks)[None]
    held = model.rollout_held(state, actions, hold)
    each = model.rollout(state, np.repeat(actions, hold, axis=1))[:, hold - 1 :: hold]
    assert np.allclose(held, each, atol=1e-9)
    now = state
    for action in np.repeat(actions, hold, axis=1)[0]:
        now = model.step(now, action[None])
    assert np.allclose(now, held[:, -1], atol=1e-9)


def test_a_decision_of_parking_is_a_step():
    env = get_setting("parking").make()
    scales, generator = np.array([100, 100, 5, 5, 1, 1]), np.random.default_rng(0)
    observation, _ = env.reset(seed=5)
    model = BicycleModel.of(env)
    for _ in range(15):
        action = generator.uniform(-1, 1, 2)
        expected = model.step(observation["observation"][None] * scales, action[None])[0]
        observation, _, terminated, _, _ = env.step(action)
        assert not terminated
        assert np.abs(observation["observation"] * scales - expected).max() < 1e-9


def test_single_precision_stays_close():
    generator = np.random.default_rng(1)
    state, actions = as_state(3, -2, 1.0, 4)[None], generator.uniform(-1, 1, (1, 30, 2))
    exact, single = (BicycleModel(dtype=t).rollout(state, actions) for t in (np.float64, np.float32))
    assert single.dtype == np.float32
    assert np.abs(exact - single).max() < 1e-3


def test_other_vehicles_and_wrong_shapes_are_refused():
    with pytest.raises(ModelError, match="ContinuousAction"):
        BicycleModel.of(get_setting("highway-fast").make())
    model = BicycleModel()
    with pytest.raises(ModelError, match=r"\(n, 6\)"):
        model.step(np.zeros((1, 4)), np.zeros((1, 2)))
    with pytest.raises(ModelError, match="hold"):
        model.rollout_held(np.zeros((1, 6)), np.zeros((1, 2, 2)), 0)
    with pytest.raises(ModelError, match="dt"):
        BicycleModel(dt=0.0)
    assert model.rollout_held(np.zeros((0, 6)), np.zeros((0, 2, 2)), 3).shape == (0, 2, 6)
