"""A highway that a shield knows from observations alone, and the decisions there."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
from highway_env.envs.highway_env import HighwayEnvFast

SEEN = {"type": "Kinematics", "vehicles_count": 30, "see_behind": True}
FRAMELESS = {"frames": False, "perception": "observation"}


def make(observation=None, **config):
    return gym.make("highway-fast-v0", config={"observation": observation or SEEN, **config})


def configured(observation=None, **config):
    return {**HighwayEnvFast.default_config(), "observation": observation or SEEN, **config}


class Actions:
    """Given actions in turn, the same for each environment of a batch."""

    def __init__(self, actions, axes=2):
        self.actions, self.at, self._axes = list(actions), 0, axes

    def predict(self, obs, state=None, episode_start=None, deterministic=False):
        action = self.actions[self.at % len(self.actions)]
        self.at += 1
        return (np.full(len(obs), action) if np.ndim(obs) > self._axes else action), state


def record(decision):
    margin = None if np.isnan(decision.margin) else round(decision.margin, 3)
    return decision.executed, decision.tier, decision.reason, margin, decision.guarantee


def driven(shielded, env, seed, decisions, seen=lambda obs: obs):
    """The decisions from one reset to the end of the episode."""
    obs, found = env.reset(seed=seed)[0], []
    for _ in range(decisions):
        action, _ = shielded.predict(seen(obs))
        found.append(record(shielded.last_decision))
        obs, _, terminated, truncated, _ = env.step(int(action))
        if terminated or truncated:
            break
    return found


def driven_in_parallel(shielded, env, seed, decisions, told=True):
    """The decisions in each environment of a VecEnv, across episodes."""
    env.seed(seed)
    obs, found, starts, ends = env.reset(), [], np.ones(env.num_envs, bool), 0
    for _ in range(decisions):
        action, _ = shielded.predict(obs, **({"episode_start": starts} if told else {}))
        found.append([record(each) for each in shielded.last_decisions])
        obs, _, starts, _ = env.step(action)
        ends += int(starts.sum())
    assert ends
    return found
