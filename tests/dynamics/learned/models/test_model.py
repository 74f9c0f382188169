"""A rollout is a repeated step, and a held rollout a rollout of repeated actions, for every model."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics.errors import ModelError
from dynamics.learned.models.model import rollout, rollout_held


class Affine:
    """A model that knows one step alone."""

    state_dim, action_dim = 3, 2

    def step(self, states, actions):
        return 0.9 * states + actions @ np.array([[1.0, 0, 2], [0, 1, -1]])


class Held(Affine):
    """A model with an answer of its own."""

    def rollout_held(self, states, actions, hold):
        return np.full((len(states), actions.shape[1], 3), float(hold))


@given(st.integers(1, 4), st.integers(0, 5), st.integers(0, 99))
def test_a_rollout_is_a_repeated_step(n, horizon, seed):
    rng = np.random.default_rng(seed)
    states, actions = rng.normal(size=(n, 3)), rng.normal(size=(n, horizon, 2))
    got = rollout(Affine(), states, actions)
    assert got.shape == (n, horizon, 3)
    for k in range(horizon):
        states = Affine().step(states, actions[:, k])
        np.testing.assert_array_equal(got[:, k], states)


@given(st.integers(1, 4), st.integers(1, 4), st.integers(1, 5), st.integers(0, 99))
def test_a_held_rollout_is_a_rollout_of_repeated_actions(n, blocks, hold, seed):
    rng = np.random.default_rng(seed)
    states, actions = rng.normal(size=(n, 3)), rng.normal(size=(n, blocks, 2))
    every = rollout(Affine(), states, np.repeat(actions, hold, axis=1))
    np.testing.assert_array_equal(rollout_held(Affine(), states, actions, hold), every[:, hold - 1 :: hold])


def test_a_model_with_its_own_held_rollout_is_used():
    assert (rollout_held(Held(), np.zeros((2, 3)), np.zeros((2, 4, 2)), 7) == 7).all()


@pytest.mark.parametrize(
    ("states", "actions", "right"),
    [
        (np.zeros((2, 4)), np.zeros((2, 5, 2)), r"\(n, 3\)"),
        (np.zeros(3), np.zeros((1, 5, 2)), r"\(n, 3\)"),
        (np.zeros((2, 3)), np.zeros((2, 5, 3)), r"\(2, horizon, 2\)"),
        (np.zeros((2, 3)), np.zeros((3, 5, 2)), r"\(2, horizon, 2\)"),
        (np.zeros((2, 3)), np.zeros((2, 2)), r"\(2, horizon, 2\)"),
    ],
)
def test_wrong_shapes_are_refused_with_the_right_ones(states, actions, right):
    for call in (lambda: rollout(Affine(), states, actions), lambda: rollout_held(Affine(), states, actions, 2)):
        with pytest.raises(ModelError, match=right):
            call()


def test_a_hold_of_nothing_is_refused():
    with pytest.raises(ModelError, match="1 or more"):
        rollout_held(Affine(), np.zeros((1, 3)), np.zeros((1, 1, 2)), 0)
