"""Wrappers between the environment and the shield are undone, or refused."""

from __future__ import annotations

import math

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import FlattenObservation, FrameStackObservation, TransformObservation
from hypothesis import given
from hypothesis import strategies as st
from seen_highway import FRAMELESS, Actions, configured, driven, make
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecNormalize, VecTransposeImage
from stable_baselines3.common.vec_env.base_vec_env import VecEnvWrapper

from evaluation.learning.fast_vec_env import FastHighwayVecEnv
from shield import ConfigError, Known, Shield
from shield.decision import Reason
from shield.perception.unwrapping import latest, undo_vec_wrappers


@pytest.mark.parametrize(
    "wrap",
    [
        FlattenObservation,
        lambda env: FrameStackObservation(env, 3),
        lambda env: FlattenObservation(FrameStackObservation(env, 2)),
        lambda env: FrameStackObservation(FlattenObservation(env), 2),
    ],
)
def test_the_latest_of_stacked_observations_is_read(wrap):
    env, plain, found = wrap(make()), make(), []
    many = 3 if isinstance(env, FrameStackObservation) and len(env.observation_space.shape) == 3 else 2
    many = 1 if type(env) is FlattenObservation and env.observation_space.shape == (150,) else many
    for each, known in (
        (plain, None),
        (env, None),
        (env, Known.from_config(configured(), stacked=many)),
    ):
        axes = len(each.observation_space.shape)
        shield = Shield(Actions([3, 0], axes), env=None if known else each, known=known, **FRAMELESS)
        found.append(driven(shield, each, 5, 6))
    assert found[0] == found[1] == found[2]
    remote = DummyVecEnv([lambda: wrap(make())])
    assert Known.of(remote)[0].stacked == many


def test_a_value_clipped_by_normalisation_is_unknown():
    inner = DummyVecEnv([make])
    world = VecNormalize(inner, clip_obs=0.5)
    inner.seed(0)
    seen = world.reset()
    for _ in range(3):
        seen, *_ = world.step([1])
    shown = undo_vec_wrappers(world, seen)
    assert np.isnan(shown).any()
    np.testing.assert_allclose(shown[~np.isnan(shown)], world.get_original_obs()[~np.isnan(shown)], atol=1e-5)
    shielded = Shield(Actions([3]), env=world, **FRAMELESS)
    shielded.predict(seen)
    assert shielded.last_decision.reason is Reason.BAD_SCENE


def test_images_are_turned_back():
    shape = (8, 9, 3)
    space = gym.spaces.Box(0, 255, shape, np.uint8)
    picture = np.random.default_rng(0).integers(0, 255, shape, np.uint8)

    class Camera(gym.Env):
        observation_space, action_space = space, gym.spaces.Discrete(2)

        def reset(self, *, seed=None, options=None):
            return picture, {}

    world = VecTransposeImage(DummyVecEnv([Camera]))
    np.testing.assert_array_equal(undo_vec_wrappers(world, world.reset())[0], picture)
    stacked = VecFrameStack(world, 2)
    np.testing.assert_array_equal(undo_vec_wrappers(stacked, stacked.reset())[0], picture)


class Halved(VecEnvWrapper):
    def __init__(self, venv):
        super().__init__(venv, observation_space=gym.spaces.Box(-1, 1, (2, 2), np.float32))

    def reset(self):
        return self.venv.reset()[:, :2, :2]

    def step_wait(self):
        return self.venv.step_wait()


def test_wrappers_that_cannot_be_undone_are_refused():
    with pytest.raises(ConfigError, match="Halved changes observations"):
        Shield(Actions([1]), env=Halved(FastHighwayVecEnv(1)), **FRAMELESS)
    doubled = TransformObservation(make(), lambda obs: 2 * obs, None)
    doubled.reset(seed=0)
    with pytest.raises(ConfigError, match="TransformObservation changes observations"):
        Shield(Actions([1]), env=doubled, **FRAMELESS)


@given(st.integers(1, 4), st.sampled_from([(4, 5), (3, 2, 6)]), st.booleans(), st.booleans())
def test_the_latest_observation_is_the_last_for_any_shape(stacked, shape, flat, batch):
    each = np.arange(stacked * math.prod(shape), dtype=float).reshape(stacked, *shape)
    shown = each if stacked > 1 else each[0]
    shown = shown.reshape(-1) if flat else shown
    np.testing.assert_array_equal(latest(shown[None] if batch else shown, shape, stacked), each[-1])
    wrong = np.zeros((stacked + 1, *shape))
    assert latest(wrong, shape, stacked) is wrong
