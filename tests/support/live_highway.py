"""A live highway-env and its compiled copy, driven side by side from wherever it has come to."""

from contextlib import suppress

import gymnasium as gym
import numpy as np
from simulator_pair import SMALL, Pair

from dynamics.errors import ShieldError

CONTINUOUS = {"type": "ContinuousAction"}


def live(config=None, seed=0, env_id="highway-fast-v0"):
    env = gym.make(env_id, config={**SMALL, "duration": 1000, **(config or {})})
    env.reset(seed=seed)
    return env


def drive_live(env, decisions=10, seed=0):
    pair = Pair.of(env)
    pair.drive(decisions, np.random.default_rng(seed))
    env.close()


def same_or_refused(make):
    """The project's own error, or the same; never something else in silence."""
    with suppress(ShieldError):
        make()
