"""A shield with nothing but what reaches `predict`: what it has to know is asked for once, and then no state is read."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from gymnasium.wrappers import FlattenObservation, FrameStackObservation, TransformObservation
from highway_env.envs.highway_env import HighwayEnvFast
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    SubprocVecEnv,
    VecFrameStack,
    VecMonitor,
    VecNormalize,
    VecTransposeImage,
)

from dynamics.scenes.scene import Scene, SceneReader, Target
from evaluation.learning.fast_vec_env import FastHighwayVecEnv
from evaluation.wrappers import SENSORS, SensorNoise
from shield import ConfigError, Known, ObservationSpec, PerceptionConfig, SceneError, Shield, ShieldedEnv
from shield.decision import Reason, Tier
from shield.perception.blind import BlindScenes
from shield.perception.sighting import decode
from shield.perception.undoing import as_shown, latest

SEEN = {"type": "Kinematics", "vehicles_count": 30, "see_behind": True}
FRAMELESS = {"frames": False, "perception": "observation"}


def make(observation=None, **config):
    return gym.make("highway-fast-v0", config={"observation": observation or SEEN, **config})


def configured(observation=None, **config):
    return {**HighwayEnvFast.default_config(), "observation": observation or SEEN, **config}


class Actions:
    """Given actions in turn, the same for each environment of a batch."""

    def __init__(self, actions, shape=(30, 5)):
        self.actions, self.at, self._shape = list(actions), 0, shape

    def predict(self, obs, state=None, episode_start=None, deterministic=False):
        action = self.actions[self.at % len(self.actions)]
        self.at += 1
        return (np.full(len(obs), action) if np.ndim(obs) > len(self._shape) else action), state


def record(decision):
    margin = None if np.isnan(decision.margin) else round(decision.margin, 3)
    return decision.executed, decision.tier, decision.reason, margin, decision.guarantee


def driven(shielded, env, seed, decisions, **start):
    """What is decided from one reset on, until the episode is over; and where the ego's controllers go."""
    obs, found, first = env.reset(seed=seed)[0], [], True
    for _ in range(decisions):
        action, _ = shielded.predict(obs, **({"episode_start": np.array([first])} if start else {}))
        found.append(record(shielded.last_decision))
        obs, _, terminated, truncated, _ = env.step(int(action))
        first = False
        if terminated or truncated:
            break
    return found


@given(
    actions=st.lists(st.integers(0, 4), min_size=3, max_size=8),
    seed=st.integers(0, 3_000),
    order=st.sampled_from(["sorted", "shuffled"]),
)
@settings(max_examples=8, deadline=None)
def test_observations_alone_decide_as_with_the_environment(actions, seed, order):
    """What the ego has been told, and the clock, are the environment's own, decision after decision."""
    env = make({**SEEN, "order": order})
    with_it = Shield(Actions(actions), env=env, **FRAMELESS)
    one = driven(with_it, env, seed, 12)
    without = Shield(Actions(actions), known=Known.from_config(configured({**SEEN, "order": order})), **FRAMELESS)
    assert driven(without, env, seed, 12) == one
    assert len(one) > 1
