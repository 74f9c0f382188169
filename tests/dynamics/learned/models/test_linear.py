"""The learned model's structure: the formula, the body frame's symmetry, rollouts, Jacobians. No training here."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from driving_data import angles, coordinates, driving, inputs, moved, states
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.errors import ConfigError, ModelError
from dynamics.learned.models.body_frame import Layout
from dynamics.learned.models.linear import LinearStructuredModel, ModelConfig

BODY = ModelConfig(members=3)
PLAIN = ModelConfig(form="plain", hide_position=False, unit_heading=False, shared=False)
seeds = st.integers(0, 50)


def random_model(config: ModelConfig, seed: int = 0) -> LinearStructuredModel:
    return LinearStructuredModel(replace(config, seed=seed)).eval().requires_grad_(False)


@settings(deadline=None)
@given(st.integers(0, 1000), states, inputs)
def test_the_plain_form_with_given_a_and_b_is_the_formula(seed, x, u):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(6, 6)), rng.normal(size=(6, 2))
    model = random_model(replace(PLAIN, members=2))
    for network, matrix in zip(model.networks, (a, b), strict=True):
        for parameter in network.parameters():
            parameter.zero_()
        network.biases[-1][:] = torch.from_numpy(matrix.reshape(-1))
    np.testing.assert_allclose(model.step(x[None], u[None])[0], x + 0.2 * (a @ x + b @ u), rtol=1e-5, atol=1e-4)
    got_a, got_b = model.matrices(x, u)
    np.testing.assert_allclose(got_a, a, rtol=1e-6)
    np.testing.assert_allclose(got_b, b, rtol=1e-6)


@settings(deadline=None)
@given(seeds, states, inputs, st.sampled_from([BODY, replace(PLAIN, members=2), replace(PLAIN, hide_position=True)]))
def test_a_and_b_at_a_point_are_those_of_the_step(seed, x, u, config):
    model = random_model(config, seed)
    a, b = model.matrices(x, u)
    want = x + model.dt * (a @ x + b @ u)
    if config.unit_heading:
        want = Layout().unit_heading(want)
    np.testing.assert_allclose(model.step(x[None], u[None])[0], want, rtol=1e-4, atol=1e-4)


@settings(deadline=None)
@given(seeds, states, inputs, coordinates, coordinates, angles)
def test_the_step_in_body_frame_commutes_with_rigid_motions(seed, x, u, dx, dy, angle):
    model = random_model(BODY, seed)
    before = model.step(moved(x, dx, dy, angle)[None], u[None])
    after = moved(model.step(x[None], u[None]).astype(float), dx, dy, angle)
    np.testing.assert_allclose(before, after, atol=1e-4)


@settings(deadline=None)
@given(seeds, states, inputs, coordinates, coordinates, angles)
def test_the_matrices_in_body_frame_turn_with_the_state(seed, x, u, dx, dy, angle):
    model = random_model(BODY, seed)
    turn = moved(np.eye(6), 0, 0, angle).T
    (a, b), (a2, b2) = model.matrices(x, u), model.matrices(moved(x, dx, dy, angle), u)
    np.testing.assert_allclose(a2, turn @ a @ turn.T, atol=1e-4)
    np.testing.assert_allclose(b2, turn @ b, atol=1e-4)


def test_the_notebooks_form_has_no_such_symmetry():
    model = random_model(PLAIN)
    x, u = np.array([[10.0, 5, 3, 0, 1, 0]]), np.array([[0.5, 0.5]])
    before, after = model.step(moved(x, 20, 0, 0), u), moved(model.step(x, u).astype(float), 20, 0, 0)
    assert np.abs(before - after).max() > 0.1
    hidden = random_model(replace(PLAIN, hide_position=True))
    before, after = hidden.step(moved(x, 20, 0, 0), u), moved(hidden.step(x, u).astype(float), 20, 0, 0)
    np.testing.assert_allclose(before, after, atol=1e-4)


@settings(deadline=None)
@given(seeds, st.lists(states, min_size=1, max_size=4), st.integers(0, 6), st.sampled_from([BODY, PLAIN]))
def test_a_rollout_is_a_repeated_step(seed, starts, horizon, config):
    model = random_model(config, seed)
    now = np.array(starts)
    actions = np.random.default_rng(seed).uniform(-1, 1, (len(now), horizon, 2))
    got = model.rollout(now, actions)
    assert got.shape == (len(now), horizon, 6)
    for k in range(horizon):
        now = model.step(now, actions[:, k])
        np.testing.assert_allclose(got[:, k], now, rtol=1e-5, atol=1e-4)


@settings(deadline=None)
@given(seeds, st.lists(states, min_size=2, max_size=5), inputs)
def test_rows_of_a_batch_are_independent(seed, starts, u):
    model = random_model(BODY, seed)
    batch, actions = np.array(starts), np.tile(u, (len(starts), 1))
    alone = np.concatenate([model.step(x[None], u[None]) for x in batch])
    np.testing.assert_allclose(model.step(batch, actions), alone, rtol=1e-5, atol=1e-5)
    batch[0] = np.nan
    got = model.step(batch, actions)
    assert np.isnan(got[0]).all()
    np.testing.assert_allclose(got[1:], alone[1:], rtol=1e-5, atol=1e-5)


@settings(deadline=None)
@given(seeds, states, inputs, st.sampled_from([BODY, PLAIN]))
def test_the_linearisation_is_exact_at_the_point_and_has_the_slopes_around_it(seed, x, u, config):
    model = random_model(replace(config, activation="tanh"), seed).double()
    x, u = x / 5, u / 2
    f, g, c = model.linearise(x, u)
    here = model.step(x[None], u[None])[0]
    np.testing.assert_allclose(f @ x + g @ u + c, here, rtol=1e-6, atol=1e-6)
    h = 1e-6
    for i in range(8):
        dx, du = np.split(np.where(np.arange(8) == i, h, 0.0), [6])
        ahead, behind = (model.step((x + s * dx)[None], (u + s * du)[None])[0] for s in (1, -1))
        np.testing.assert_allclose((f @ dx + g @ du) / h, (ahead - behind) / (2 * h), rtol=1e-5, atol=1e-5)


@settings(deadline=None)
@given(seeds, states, inputs)
def test_disagreement_is_the_spread_of_the_members(seed, x, u):
    model = random_model(BODY, seed)
    each = model.members(*(torch.tensor(part[None], dtype=torch.float32) for part in (x, u))).numpy()
    np.testing.assert_allclose(model.disagreement(x[None], u[None]), each.std(axis=0), atol=1e-5)
    assert (model.disagreement(x[None], u[None]).max() > 1e-5).all()
    assert (random_model(replace(BODY, members=1), seed).disagreement(x[None], u[None]) == 0).all()


@settings(deadline=None)
@given(seeds, states, inputs)
def test_the_prediction_is_the_mean_of_the_members_but_for_the_heading(seed, x, u):
    model = random_model(replace(BODY, unit_heading=False), seed)
    each = model.members(*(torch.tensor(part[None], dtype=torch.float32) for part in (x, u))).numpy()
    np.testing.assert_allclose(model.step(x[None], u[None]), each.mean(axis=0), rtol=1e-5, atol=1e-4)


@settings(deadline=None)
@given(seeds, states, inputs)
def test_the_heading_stays_a_direction(seed, x, u):
    got = random_model(BODY, seed).step(x[None], u[None])[0]
    assert np.hypot(got[4], got[5]) == pytest.approx(1, abs=1e-5)


@settings(deadline=None)
@given(st.floats(0.1, 10), st.floats(0.1, 10))
def test_normalisation_is_inside(length, time):
    """Fitted to the same data in other units of length and time, it predicts the same in those units."""
    data = driving(3, 10)
    units = np.array([length, length, length / time, length / time, 1, 1])
    plain, scaled = (random_model(replace(BODY, dt=0.2 * factor)) for factor in (1.0, time))
    for model, factor in ((plain, 1.0), (scaled, units)):
        parts = (data.states * factor, data.actions, data.next_states * factor)
        model.normalise(*(torch.tensor(part, dtype=torch.float32) for part in parts))
    want = plain.step(data.states, data.actions) * units
    np.testing.assert_allclose(scaled.step(data.states * units, data.actions), want, rtol=1e-3, atol=1e-3 * length)


@pytest.mark.parametrize(
    ("states", "actions"),
    [
        (np.zeros((2, 5)), np.zeros((2, 2))),
        (np.zeros(6), np.zeros(2)),
        (np.zeros((2, 6)), np.zeros((3, 2))),
        (np.zeros((2, 6)), np.zeros((2, 3))),
    ],
)
def test_wrong_dimensions_are_refused(states, actions):
    model = random_model(BODY)
    for call in (model.step, model.disagreement, lambda x, u: model.rollout(x, np.asarray(u)[:, None])):
        with pytest.raises(ModelError, match="must have shape"):
            call(states, actions)


def test_wrong_dimensions_at_a_point_are_refused():
    model = random_model(BODY)
    for call in (model.matrices, model.linearise):
        with pytest.raises(ModelError, match="must have shape"):
            call(np.zeros(5), np.zeros(2))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"form": "polar"}, "form must be one of"),
        ({"activation": "gelu2"}, "activation must be one of"),
        ({"members": 0}, "members"),
        ({"members": True}, "members"),
        ({"hidden": (8, 0)}, r"hidden\[1\]"),
        ({"dt": 0.0}, "dt"),
        ({"dt": float("nan")}, "dt"),
        ({"units": (1.0,)}, "6 positive scales"),
        ({"units": (1.0, 1, 1, 1, 1, 0)}, "6 positive scales"),
        ({"state_dim": 5}, "columns 0 to 4"),
    ],
)
def test_invalid_configurations_are_refused(change, message):
    with pytest.raises(ConfigError, match=message):
        ModelConfig(**change)


def test_a_configuration_survives_json():
    config = ModelConfig(form="plain", units=(1.0, 1, 2, 2, 1, 1), hidden=(8,), shared=False)
    assert ModelConfig.from_json(json.loads(json.dumps(config.to_json()))) == config
