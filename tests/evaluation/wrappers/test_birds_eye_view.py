"""`BirdsEyeView`, and frames as observations of the compiled VecEnvs."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO

from dynamics.world_model import BirdsEye, FrameView
from evaluation.learning.fast_road_vec_env import FastRoadVecEnv
from evaluation.learning.fast_vec_env import FastHighwayVecEnv
from evaluation.learning.shielded_vec_env import ShieldedVecEnv
from evaluation.wrappers import BirdsEyeView
from shield import Shield, ShieldedEnv
from shield.errors import ConfigError

VIEW = FrameView(size=32)
SHORT = {"duration": 3}


def test_observations_are_in_the_space_of_the_wrapper() -> None:
    env = BirdsEyeView(gym.make("highway-fast-v0"), VIEW)
    first, again = env.reset(seed=4)[0], env.reset(seed=4)[0]
    assert (first == again).all()
    assert env.observation_space.contains(first)
    assert env.observation_space.contains(env.step(3)[0])
    colour = BirdsEyeView(gym.make("highway-fast-v0"), VIEW, colour=True)
    observation, _ = colour.reset(seed=0)
    assert observation.shape == (3, 32, 32)
    assert colour.observation_space.contains(observation)


def test_a_shield_may_be_inside_or_outside() -> None:
    """A shield reads the simulator's state, so both orders drive and see the same."""
    inside = BirdsEyeView(ShieldedEnv(gym.make("highway-fast-v0")))
    outside: Any = ShieldedEnv(BirdsEyeView(gym.make("highway-fast-v0")))
    seen = [env.reset(seed=1)[0] for env in (inside, outside)]
    for _ in range(4):
        assert (seen[0] == seen[1]).all()
        seen = [env.step(3)[0] for env in (inside, outside)]
    assert (seen[0] == BirdsEye().frame(inside)).all()


def test_other_environments_are_refused() -> None:
    with pytest.raises(ConfigError, match="BirdsEyeView"):
        BirdsEyeView(gym.make("CartPole-v1"))


@pytest.mark.parametrize(
    ("kind", "env_id"), [(FastHighwayVecEnv, "highway-fast-v0"), (FastRoadVecEnv, "roundabout-v0")]
)
def test_frames_change_no_episode_and_end_with_the_last_one(kind: Any, env_id: str) -> None:
    """The same rewards and ends as without frames; a new episode begins after an end, and the terminal frame is the one
    before it."""
    plain, framed = kind(3, env_id, SHORT), kind(3, env_id, SHORT, frames=VIEW)
    for world in (plain, framed):
        world.seed(7)
        world.reset()
    rng, ended = np.random.default_rng(0), 0
    for _ in range(30):
        actions = rng.integers(5, size=3)
        _, rewards, dones, infos = plain.step(actions)
        frames, same_rewards, same_dones, framed_infos = framed.step(actions)
        assert (rewards == same_rewards).all()
        assert (dones == same_dones).all()
        assert frames.shape == (3, *VIEW.shape)
        for i in np.flatnonzero(dones):
            ended += 1
            assert infos[i]["episode"]["r"] == framed_infos[i]["episode"]["r"]
            last = framed_infos[i]["terminal_observation"]
            assert last.shape == VIEW.shape
            assert (last != frames[i]).any()
        states = [world.simulator for world in (plain, framed)]
        worlds = [each.worlds if hasattr(each, "worlds") else each.episodes.worlds for each in states]
        assert (worlds[0].f == worlds[1].f).all()
    assert ended > 2


def test_frames_of_a_shielded_batch() -> None:
    plain, framed = (
        ShieldedVecEnv(2, "highway-fast-v0", SHORT),
        ShieldedVecEnv(2, "highway-fast-v0", SHORT, frames=VIEW),
    )
    for world in (plain, framed):
        world.seed(3)
        world.reset()
    for _ in range(8):
        _, rewards, dones, infos = plain.step([3, 3])
        frames, same, same_dones, framed_infos = framed.step([3, 3])
        assert frames.dtype == np.uint8
        assert (rewards == same).all()
        assert (dones == same_dones).all()
        assert [each["shield"] for each in infos] == [each["shield"] for each in framed_infos]


def test_a_cnn_policy_trains_and_drives_behind_the_shield() -> None:
    world = FastHighwayVecEnv(2, "highway-fast-v0", frames=FrameView())
    model = PPO("CnnPolicy", world, n_steps=8, batch_size=16, n_epochs=1, device="cpu").learn(16)
    env = BirdsEyeView(gym.make("highway-fast-v0"))
    shield = Shield(model, env=env)
    observation, _ = env.reset(seed=0)
    for _ in range(2):
        action, _ = shield.predict(observation, deterministic=True)
        observation, *_ = env.step(int(action))
    assert shield.last_decision is not None
