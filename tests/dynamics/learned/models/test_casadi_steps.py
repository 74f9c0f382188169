"""A learned model as an expression equals the network's step, at any place and heading, with its derivatives."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.errors import ConfigError, ModelError
from dynamics.learned.models.body_frame import Layout
from dynamics.learned.models.casadi_steps import TOLERANCE, LearnedStep, LearnedSteps, actuator_notes
from dynamics.learned.models.files import save_model
from dynamics.learned.models.linear import LinearStructuredModel, ModelConfig
from dynamics.vehicle.actuators import Actuators

ACTUATORS = Actuators(acceleration=(-10.0, 5.0))
floats = st.floats
states = st.tuples(floats(-50, 50), floats(-20, 20), floats(-3, 3), floats(-5, 40)).map(np.array)
inputs = st.tuples(floats(-10, 5), floats(-0.78, 0.78)).map(np.array)


def network(**changes) -> LinearStructuredModel:
    """Random weights, normalised to some driving, so that nothing in it is trivial."""
    model = LinearStructuredModel(ModelConfig(hidden=(8, 8), **changes))
    rng = np.random.default_rng(1)
    heading, speed = rng.uniform(-3, 3, 200), rng.uniform(0, 40, 200)
    c, s = np.cos(heading), np.sin(heading)
    now = np.stack([*rng.uniform(-9, 9, (2, 200)), speed * c, speed * s, c, s], axis=1)
    after = now + 0.2 * np.stack([speed * c, speed * s, c, -s, -0.1 * s, 0.1 * c], axis=1)
    parts = (now, rng.uniform(-1, 1, (200, 2)), after)
    model.normalise(*(torch.as_tensor(part.astype(np.float32)) for part in parts))
    return model.eval().requires_grad_(False)


KINDS = [
    {"members": 1},
    {"members": 3},
    {"members": 2, "shared": False, "activation": "tanh"},
    {"members": 1, "activation": "relu", "unit_heading": False},
]
MODELS = [network(**kind) for kind in KINDS]
STEPS = [LearnedStep(model, ACTUATORS) for model in MODELS]
X, U = ca.SX.sym("x", 4), ca.SX.sym("u", 2)


def function(step, duration=0.2):
    after = step.held(X, U, duration)
    return ca.Function("step", [X, U], [after, ca.jacobian(after, X), ca.jacobian(after, U)])


FUNCTIONS = [function(step) for step in STEPS]


def learned_state(x):
    """(x, y, psi, v) as the model's state."""
    c, s = np.cos(x[2]), np.sin(x[2])
    return np.array([x[0], x[1], x[3] * c, x[3] * s, c, s])


def torch_step(model, x, u):
    """The model's own step of (x, y, psi, v), as (x, y, cos, sin, v)."""
    action = ACTUATORS.normalised(u)
    o = model.step(learned_state(x)[None], action[None])[0].astype(float)
    length = np.hypot(o[4], o[5])
    return np.array([o[0], o[1], o[4] / length, o[5] / length, (o[2] * o[4] + o[3] * o[5]) / length])


@pytest.mark.parametrize("i", range(len(KINDS)))
@given(x=states, u=inputs)
@settings(max_examples=60, deadline=None)
def test_the_expression_is_the_networks_step_to_the_stated_tolerance(i, x, u):
    got = FUNCTIONS[i](x, u)[0].full().ravel()
    wanted = torch_step(MODELS[i], x, u)
    seen = np.array([got[0], got[1], np.cos(got[2]), np.sin(got[2]), got[3]])
    assert np.abs(seen - wanted).max() <= TOLERANCE * max(1.0, np.abs(wanted).max())


@pytest.mark.parametrize("i", [0, 1, 2])
@given(x=states, u=inputs)
@settings(max_examples=30, deadline=None)
def test_the_derivatives_of_the_expression_are_correct(i, x, u):
    """Central differences; that the values are the network's is the test before."""
    _, f, g = (np.asarray(part.full()) for part in FUNCTIONS[i](x, u))
    h = 1e-5
    for jacobian, point, other in ((f, x, "x"), (g, u, "u")):
        for column in range(len(point)):
            shift = np.eye(len(point))[column] * h
            ends = [FUNCTIONS[i](x + s, u) if other == "x" else FUNCTIONS[i](x, u + s) for s in (shift, -shift)]
            slope = (ends[0][0].full() - ends[1][0].full()).ravel() / (2 * h)
            np.testing.assert_allclose(jacobian[:, column], slope, rtol=1e-4, atol=1e-4)


@given(states, inputs, floats(-20, 20), floats(-20, 20), floats(-3, 3))
@settings(max_examples=30, deadline=None)
def test_the_step_commutes_with_rigid_motions(x, u, right, up, angle):
    def moved(state):
        c, s = np.cos(angle), np.sin(angle)
        return np.array(
            [right + c * state[0] - s * state[1], up + s * state[0] + c * state[1], state[2] + angle, state[3]]
        )

    first = FUNCTIONS[0](x, u)[0].full().ravel()
    np.testing.assert_allclose(FUNCTIONS[0](moved(x), u)[0].full().ravel(), moved(first), atol=1e-8)


@given(states, inputs, st.integers(1, 4))
@settings(max_examples=20, deadline=None)
def test_holding_an_input_is_repeating_the_step(x, u, count):
    state = x
    for _ in range(count):
        state = FUNCTIONS[0](state, u)[0].full().ravel()
    np.testing.assert_allclose(function(STEPS[0], 0.2 * count)(x, u)[0].full().ravel(), state, atol=1e-9)


def test_an_input_is_held_by_the_longest_step_that_fits():
    long, short = STEPS[0], LearnedStep(network(members=1, dt=0.05), ACTUATORS)
    both = LearnedSteps(short, long)
    x, u = np.array([0.0, 0.0, 0.1, 20.0]), np.array([1.0, 0.02])
    for duration, used in ((0.2, long), (0.4, long), (0.05, short), (0.15, short)):
        got, wanted = function(both, duration)(x, u)[0], function(used, duration)(x, u)[0]
        assert got.full().tobytes() == wanted.full().tobytes(), duration
    for steps, have in ((both, "0.2, 0.05"), (long, "0.2")):
        with pytest.raises(ConfigError, match=have):
            steps.held(X, U, 1 / 15)
    with pytest.raises(ModelError, match="at least one"):
        LearnedSteps()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"form": "plain"}, "form 'plain'"),
        ({"layout": Layout((0, 1), (2, 3), ((4, 5),))}, "laid out"),
        ({"state_dim": 7}, "7 columns"),
        ({"action_dim": 3}, "3 inputs"),
    ],
)
def test_a_model_of_something_else_is_refused(changes, message):
    with pytest.raises(ModelError, match=message):
        LearnedStep(LinearStructuredModel(ModelConfig(members=1, **changes)))


def test_weights_that_are_not_finite_and_missing_actuators_are_refused():
    broken = network(members=1)
    broken.networks[0].biases[0].data[:] = np.nan
    with pytest.raises(ModelError, match="not finite"):
        LearnedStep(broken)
    with pytest.raises(ModelError, match="lateral False"):
        LearnedStep(MODELS[0], replace(ACTUATORS, lateral=False))


def test_a_stored_model_knows_its_actuators(tmp_path):
    save_model(MODELS[0], tmp_path / "good", actuator_notes(ACTUATORS))
    step = LearnedStep.load(tmp_path / "good")
    assert step.actuators == ACTUATORS
    x, u = np.array([3.0, 1.0, 0.2, 25.0]), np.array([-7.0, 0.1])
    assert function(step)(x, u)[0].full().tobytes() == FUNCTIONS[0](x, u)[0].full().tobytes()
    for name, notes in (("none", {}), ("bad", {"actuators": {"acceleration": [1, -1], "steering": [-1, 1]}})):
        save_model(MODELS[0], tmp_path / name, notes)
        with pytest.raises(ModelError, match=r"throttle and steering.*fit --setting"):
            LearnedStep.load(tmp_path / name)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda step: pickle.loads(pickle.dumps(step))])
def test_a_copy_is_the_same_step(copied):
    x, u = np.array([3.0, 1.0, 0.2, 25.0]), np.array([-7.0, 0.1])
    for step in (STEPS[0], LearnedSteps(STEPS[0])):
        assert function(copied(step))(x, u)[0].full().tobytes() == FUNCTIONS[0](x, u)[0].full().tobytes()
