"""Small models and policies of every kind, in a short highway-fast-v0."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
from sb3_contrib import QRDQN, TRPO, MaskablePPO, RecurrentPPO
from stable_baselines3 import A2C, DQN, PPO

__all__ = ["KINDS", "SHORT", "Always", "Playback", "Ranked", "make", "model_of"]

SHORT = {"duration": 6}
KINDS = {
    "PPO": (PPO, "MlpPolicy", {"n_steps": 8, "batch_size": 8}),
    "A2C": (A2C, "MlpPolicy", {}),
    "DQN": (DQN, "MlpPolicy", {"buffer_size": 100}),
    "QRDQN": (QRDQN, "MlpPolicy", {"buffer_size": 100}),
    "TRPO": (TRPO, "MlpPolicy", {"n_steps": 8, "batch_size": 8}),
    "MaskablePPO": (MaskablePPO, "MlpPolicy", {"n_steps": 8, "batch_size": 8}),
    "RecurrentPPO": (RecurrentPPO, "MlpLstmPolicy", {"n_steps": 8, "batch_size": 8}),
}


def make(**config):
    return gym.make("highway-fast-v0", config={**SHORT, **config})


def model_of(name, env):
    kind, policy, kwargs = KINDS[name]
    return kind(policy, env, policy_kwargs={"net_arch": [8]}, device="cpu", seed=0, **kwargs)


class Playback:
    """Actions one after the other, as an object with SB3's `predict`."""

    def __init__(self, actions):
        self._actions = iter(actions)

    def __call__(self, observation):
        return next(self._actions)

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return np.asarray(next(self._actions)), state


class Always:
    """A constant action, as an object with SB3's `predict`."""

    def __init__(self, action, scores=None):
        self.action, self.scores = action, scores

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        batch = np.ndim(observation) - 2
        return (np.full(len(observation), self.action) if batch else np.array(self.action)), state


class Ranked(Always):
    """The same with an order of preference."""

    def action_scores(self, obs):
        return np.tile(self.scores, (1 if np.ndim(obs) == 2 else len(obs), 1))
