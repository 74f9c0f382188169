"""Roads and their observations, for the tests of perception."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)

from dynamics.roads.straight import StraightRoad

__all__ = ["ANY", "ROAD", "SEEN", "make"]

SEEN = {"type": "Kinematics", "vehicles_count": 15, "see_behind": True}
ROAD = StraightRoad.from_lanes(4)
ANY = 20.0, 1e4, 1e9
"""A usual speed that says nothing."""


def make(observation, **config):
    return gym.make("highway-fast-v0", config={"observation": observation, **config})
