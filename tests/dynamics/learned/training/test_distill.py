"""Macro-steps agree with the model within their stated distance, and keep its symmetry."""

from __future__ import annotations

import numpy as np
import pytest
from driving_data import angles, coordinates, driving, inputs, moved, states
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.errors import ConfigError, ModelError
from dynamics.learned.models.linear import LinearStructuredModel, ModelConfig
from dynamics.learned.models.model import HeldModel, rollout
from dynamics.learned.training.distill import DistillConfig, distill
from dynamics.learned.training.fit import FitConfig, fit

DATA = driving(16, 30)
MODEL = fit(DATA, ModelConfig(members=2, hidden=(16, 16)), FitConfig(epochs=60, finish_epochs=0, batch=64)).model
FAST = distill(MODEL, DATA, DistillConfig(holds=(1, 2, 4)))
known = st.integers(0, len(DATA) - 1)


@settings(deadline=None)
@given(st.lists(known, min_size=1, max_size=20), st.sampled_from([1, 2, 4]), st.integers(0, 99))
def test_a_macro_step_is_within_the_stated_distance_of_the_model(rows, hold, seed):
    x = DATA.states[rows]
    u = np.random.default_rng(seed).uniform(-1, 1, (len(rows), 1, 2))
    got = FAST.rollout_held(x, u, hold)[:, 0]
    want = MODEL.rollout(x, np.repeat(u, hold, axis=1))[:, -1]
    agreement = FAST.agreement[hold]
    assert agreement.median <= agreement.p99 <= agreement.worst
    assert agreement.p99 <= 0.02 * hold
    # The states of the data are well inside the range in which the worst case was searched.
    assert np.hypot(*(got - want)[:, :2].T).max() <= 2 * agreement.worst + 1e-4
    np.testing.assert_allclose(got[:, 2:4], want[:, 2:4], atol=0.2)
    np.testing.assert_allclose(got[:, 4:], want[:, 4:], atol=0.05)


@settings(deadline=None)
@given(st.lists(known, min_size=1, max_size=8), st.integers(0, 99))
def test_the_errors_of_several_blocks_add_up_slowly(rows, seed):
    x = DATA.states[rows] * [1, 1, 0.3, 0.3, 1, 1]
    # Gentle on the throttle: the speeds stay in the range of the data.
    u = np.random.default_rng(seed).uniform(-1, 1, (len(rows), 3, 2)) * [0.3, 1]
    want = MODEL.rollout(x, np.repeat(u, 4, axis=1))[:, 3::4]
    np.testing.assert_allclose(FAST.rollout_held(x, u, 4)[..., :2], want[..., :2], atol=0.3)


@settings(deadline=None)
@given(states, inputs, inputs, coordinates, coordinates, angles)
def test_a_macro_step_commutes_with_rigid_motions(x, u, w, dx, dy, angle):
    actions = np.array([[u, w]])
    before = FAST.rollout_held(moved(x, dx, dy, angle)[None], actions, 4)[0]
    after = moved(FAST.rollout_held(x[None], actions, 4)[0].astype(float), dx, dy, angle)
    np.testing.assert_allclose(before, after, atol=2e-3)


@settings(deadline=None)
@given(st.lists(known, min_size=1, max_size=5), st.integers(1, 4), st.integers(0, 99))
def test_step_rollout_and_held_rollout_agree(rows, horizon, seed):
    x = DATA.states[rows]
    u = np.random.default_rng(seed).uniform(-1, 1, (len(rows), horizon, 2))
    want = rollout(FAST, x, u)
    np.testing.assert_allclose(FAST.rollout(x, u), want, atol=1e-3)
    np.testing.assert_allclose(FAST.rollout_held(x, u, 1), want, atol=1e-3)


@settings(deadline=None)
@given(known, inputs)
def test_a_hold_without_polynomial_is_put_together(row, u):
    x = DATA.states[row][None]
    parts = FAST.rollout_held(
        FAST.rollout_held(FAST.rollout_held(x, u[None, None], 4)[:, -1], u[None, None], 2)[:, -1], u[None, None], 1
    )[:, -1]
    np.testing.assert_allclose(FAST.rollout_held(x, u[None, None], 7)[:, -1], parts, atol=1e-3)


@settings(deadline=None)
@given(known, st.floats(-100, 100), inputs)
def test_a_macro_step_beyond_its_range_stays_finite_and_bounded(row, speed, u):
    x = DATA.states[row].copy()
    x[2:4] = speed * x[4:]
    out = FAST.rollout_held(x[None], np.tile(u, (1, 8, 1)), 4)
    assert np.isfinite(out).all()
    assert np.abs(out).max() < 500


def test_rows_without_blocks_and_blocks_without_rows():
    assert FAST.rollout_held(np.zeros((0, 6)), np.zeros((0, 3, 2)), 4).shape == (0, 3, 6)
    assert FAST.rollout_held(DATA.states[:2], np.zeros((2, 0, 2)), 4).shape == (2, 0, 6)


def test_planners_find_the_fast_path():
    assert isinstance(FAST, HeldModel)
    assert FAST.holds == (1, 2, 4)
    assert (FAST.state_dim, FAST.action_dim, FAST.dt) == (6, 2, 0.2)


def test_the_tolerance_is_kept_or_refused():
    with pytest.raises(ModelError, match="more than the tolerance of 1e-06 m"):
        distill(MODEL, DATA, DistillConfig(tolerance=1e-6))


def test_an_unsupported_model_or_input_is_refused():
    with pytest.raises(ConfigError, match="in the form 'body'"):
        distill(LinearStructuredModel(ModelConfig(form="plain")), DATA)
    with pytest.raises(ConfigError, match="20 samples are too few"):
        distill(MODEL, DATA, DistillConfig(samples=20))
    with pytest.raises(ModelError, match="1 or more"):
        FAST.rollout_held(DATA.states[:1], np.zeros((1, 1, 2)), 0)
    with pytest.raises(ModelError, match="must have shape"):
        FAST.rollout_held(DATA.states[:1], np.zeros((1, 1, 3)), 1)
    with pytest.raises(ModelError, match="must have shape"):
        FAST.step(DATA.states[:1], np.zeros((2, 2)))


@pytest.mark.parametrize(
    "change", [{"holds": (0,)}, {"degree": 0}, {"samples": 0}, {"tolerance": 0.0}, {"stretch": 0.5}]
)
def test_invalid_settings_of_distillation_are_refused(change):
    with pytest.raises(ConfigError, match="positive"):
        DistillConfig(**change)
