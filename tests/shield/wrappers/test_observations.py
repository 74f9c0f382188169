"""The policy's observation does not affect the shield, which reads the simulator's state."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
from stable_baselines3 import PPO

from shield import Shield, ShieldConfig, ShieldedEnv

IMAGE = {
    "type": "GrayscaleObservation",
    "observation_shape": (64, 64),
    "stack_size": 2,
    "weights": [0.2989, 0.587, 0.114],
    "scaling": 1.75,
}
SEEN = {
    "lidar": {"type": "LidarObservation", "cells": 16},
    "image": IMAGE,
    "grid": {"type": "OccupancyGrid"},
    "state": {"type": "Kinematics"},
}
EXACT = ShieldConfig.simulated_traffic()
ROADS = {"highway-fast-v0": ShieldConfig(), "roundabout-v1": EXACT, "intersection-v2": EXACT}


def ways(env_id, config, seen):
    """The ego's path in both wrappers, always faster."""
    envs = [gym.make(env_id, config={"observation": SEEN[seen]}) for _ in range(2)]
    action = envs[0].unwrapped.action_type.actions_indexes["FASTER"]
    wrapped, shield = ShieldedEnv(envs[0], config), Shield(lambda obs: action, envs[1], config)
    wrapped.reset(seed=31)
    obs, _ = envs[1].reset(seed=31)
    assert envs[1].observation_space.contains(obs)
    way = []
    for _ in range(4):
        wrapped.step(action)
        obs, *_ = envs[1].step(shield.predict(obs)[0])
        way.append([*envs[0].unwrapped.vehicle.position, *envs[1].unwrapped.vehicle.position])
    return np.array(way)


@pytest.mark.parametrize("env_id", ROADS)
@pytest.mark.parametrize("seen", ["lidar", "image", "grid"])
def test_the_observation_does_not_change_the_driven_path(env_id, seen):
    assert np.array_equal(ways(env_id, ROADS[env_id], seen), ways(env_id, ROADS[env_id], "state"))


@pytest.mark.parametrize("seen", ["lidar", "image"])
def test_a_model_of_each_observation_can_be_wrapped(seen):
    env = gym.make("roundabout-v1", config={"observation": SEEN[seen]})
    policy = "MlpPolicy" if seen == "lidar" else "CnnPolicy"
    kwargs = {} if seen == "lidar" else {"policy_kwargs": {"features_extractor_kwargs": {"features_dim": 8}}}
    model = PPO(policy, env, n_steps=8, batch_size=8, device="cpu", seed=0, **kwargs)
    shield = Shield(model, env, EXACT)
    obs, _ = env.reset(seed=32)
    for _ in range(4):
        action, _ = shield.predict(obs, deterministic=True)
        obs, *_ = env.step(int(action))
    assert not env.unwrapped.vehicle.crashed
