"""Environments of a user's own, registered with Gymnasium as users do: with a configuration, a class, a function."""

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


def register():
    """Under registered-stock-v0, registered-own-v0 and registered-function-v0."""
    for name, entry, kwargs in (
        ("stock", "highway_env.envs.highway_env:HighwayEnvFast", {"config": CONFIG}),
        ("own", OwnReward, {"config": CONFIG}),
        ("function", of_lanes, {"lanes": 2}),
    ):
        if f"registered-{name}-v0" not in gym.registry:
            gym.register(f"registered-{name}-v0", entry_point=entry, kwargs=kwargs)


register()
