"""Throttle and steering on roads whose rewards in highway-env are for meta-actions."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from highway_env.vehicle.dynamics import BicycleVehicle
from stable_baselines3 import PPO

from evaluation.settings import get_setting
from evaluation.wrappers import ThrottleAndSteering
from evaluation.wrappers.throttle_and_steering import ROADS
from shield import ConfigError


@pytest.mark.parametrize("road", ROADS)
def test_highway_env_refuses_such_environments_and_the_wrapper_makes_them(road):
    """If highway-env comes to make one, it is to be taken from there."""
    with pytest.raises((ValueError, AttributeError)):
        gym.make(road, config={"action": {"type": "ContinuousAction"}})
    name, version = road.rsplit("-", 1)
    env = gym.make(f"{name}-continuous-{version}")
    obs, _ = env.reset(seed=0)
    assert env.action_space.shape == (2,)
    assert env.observation_space.contains(obs)
    total = 0.0
    for _ in range(5):
        obs, reward, terminated, truncated, info = env.step(np.array([0.2, 0.0], np.float32))
        assert env.observation_space.contains(obs)
        total += reward
        if terminated or truncated:
            break
    assert np.isfinite(total)
    assert "rewards" in info
    assert not {"speed_index", "target_speeds", "route"} & set(vars(env.unwrapped.vehicle))


def test_the_reward_is_that_of_meta_actions_in_the_same_state():
    """Idle in the middle of a lane at the target speed: vehicles of both kinds move alike."""
    meta, inputs = gym.make("roundabout-v1"), ThrottleAndSteering(gym.make("roundabout-v1"))
    meta.reset(seed=1)
    inputs.reset(seed=1)
    one, other = meta.unwrapped, inputs.unwrapped
    for env in (one, other):
        env.vehicle.speed = 16.0
    assert other._rewards(np.zeros(2))["on_road_reward"] == one._rewards(1)["on_road_reward"]
    assert other._rewards(np.zeros(2))["lane_change_reward"] == 0
    assert other._rewards(np.zeros(2))["high_speed_reward"] == 2 / 2


def test_a_road_that_ends_pays_nothing_for_missing_lanes():
    env = ThrottleAndSteering(gym.make("two-way-v0"))
    env.reset(seed=0)
    base = env.unwrapped
    base.vehicle.position = base.road.network.get_lane(("b", "a", 0)).position(100, 0)
    base.vehicle.heading = np.pi
    base.vehicle.on_state_update()
    assert base._rewards(np.zeros(2))["left_lane_reward"] == 0.0


def test_options_of_the_action_are_passed_on():
    env = ThrottleAndSteering(gym.make("merge-v1"), lateral=False, acceleration_range=[-3.0, 2.0])
    assert env.action_space.shape == (1,)
    assert env.unwrapped.action_type.acceleration_range == [-3.0, 2.0]
    tyres = gym.make("merge-continuous-v1", config={"action": {"type": "ContinuousAction", "dynamical": True}})
    tyres.reset(seed=0)
    assert type(tyres.unwrapped.vehicle) is BicycleVehicle


def test_the_environments_pass_gymnasiums_check_and_can_be_learned_on():
    check_env(gym.make("roundabout-continuous-v1").unwrapped, skip_render_check=True)
    env = get_setting("roundabout-continuous").make()
    PPO("MlpPolicy", env, n_steps=8, batch_size=8, device="cpu", seed=0).learn(8)


def test_unsupported_environments_are_refused():
    with pytest.raises(ConfigError, match="RacetrackEnv has ContinuousAction"):
        ThrottleAndSteering(gym.make("racetrack-v0"))
    with pytest.raises(ConfigError, match="no actions of highway-env"):
        ThrottleAndSteering(gym.make("CartPole-v1"))
    with pytest.raises(ConfigError, match="other actions"):
        gym.make("merge-continuous-v1", config={"action": {"type": "DiscreteMetaAction"}})
