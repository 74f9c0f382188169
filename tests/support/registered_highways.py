"""Environments of a user's own, registered with Gymnasium as users do: with a configuration, a class, a function."""

from contextlib import contextmanager

import gymnasium as gym
from highway_env.envs.highway_env import HighwayEnvFast

CONFIG = {"lanes_count": 2, "duration": 3, "vehicles_count": 4}


class OwnReward(HighwayEnvFast):
    """highway-fast-v0 with another reward."""

    def _reward(self, action):
        return 1.0


def of_lanes(lanes=1, render_mode=None):
    """Made by a function that takes no configuration."""
    return HighwayEnvFast({**CONFIG, "lanes_count": lanes}, render_mode=render_mode)


IDS = ("registered-stock-v0", "registered-own-v0", "registered-function-v0")


@contextmanager
def registered():
    """Registers `IDS` for a while."""
    entries = "highway_env.envs.highway_env:HighwayEnvFast", OwnReward, of_lanes
    for env_id, entry in zip(IDS, entries, strict=True):
        gym.register(env_id, entry_point=entry, kwargs={"lanes": 2} if entry is of_lanes else {"config": CONFIG})
    try:
        yield
    finally:
        for env_id in IDS:
            gym.registry.pop(env_id)
