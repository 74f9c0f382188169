"""Rounds: the model of one drives in the next, and all data are kept."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces

from dynamics.errors import ConfigError
from dynamics.learned.data.collect import RepeatedRandomPolicy
from dynamics.learned.models.bicycle import BicycleModel
from dynamics.learned.models.linear import LinearStructuredModel, ModelConfig
from dynamics.learned.training.fit import FitConfig
from dynamics.learned.training.on_policy_rounds import RoundsConfig, rounds


class Yard(gym.Env):
    """The bicycle on an endless plane."""

    observation_space = spaces.Box(-np.inf, np.inf, (6,))
    action_space = spaces.Box(-1.0, 1.0, (2,))
    _model = BicycleModel()

    def reset(self, *, seed=None, options=None):
        self.state = np.array([0.0, 0, 0, 0, 1, 0])
        return self.state, {}

    def step(self, action):
        self.state = self._model.step(self.state[None], np.asarray(action)[None])[0]
        return self.state, 0.0, False, False, {}


CONFIG = RoundsConfig(transitions=60, rounds=2, per_round=20, episode_steps=10, on_policy_steps=10)
FIT = FitConfig(epochs=10, finish_epochs=1, batch=64)
MODEL = ModelConfig(members=1, hidden=(8,))


def test_each_round_drives_with_the_model_before_and_adds_its_data():
    asked = []

    def policy_of(model, data):
        asked.append((model, len(data)))
        return RepeatedRandomPolicy(Yard.action_space, np.random.default_rng(0))

    done = list(rounds(Yard(), lambda x: x, MODEL, policy_of, CONFIG, FIT))
    assert [r.number for r in done] == [0, 1, 2]
    assert [len(r.data) for r in done] == [60, 80, 100]
    assert [n for _, n in asked] == [60, 80]
    assert all(isinstance(model, LinearStructuredModel) for model, _ in asked)
    assert [model for model, _ in asked] == [r.fit.model for r in done[:2]]
    np.testing.assert_array_equal(done[2].data.states[:80], done[1].data.states)
    fresh = done[2].data.actions[60:]
    assert (fresh[:20] == fresh[20:]).all()  # the driver above always draws the same


def test_the_same_seed_gives_the_same_model():
    def last(seed):
        config = RoundsConfig(transitions=60, rounds=0, episode_steps=10, seed=seed)
        (only,) = rounds(Yard(), lambda x: x, MODEL, None, config, FIT)
        return only.fit.model.step(only.data.states[:5] * 0, only.data.actions[:5] * 0 + 0.5)

    np.testing.assert_array_equal(last(0), last(0))
    assert not np.array_equal(last(0), last(1))


def test_rounds_without_a_driver_are_refused():
    with pytest.raises(ConfigError, match="need policy_of"):
        next(rounds(Yard(), lambda x: x, MODEL, None, CONFIG, FIT))
    with pytest.raises(ConfigError, match="positive"):
        RoundsConfig(transitions=0)
