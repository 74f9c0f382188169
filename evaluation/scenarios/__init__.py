"""Environments of our own. Importing the package registers `ComplexRoads-v0` with Gymnasium, and
`lane-keeping-half-minute-v0`: highway-env's lane keeping, which has no end, for 300 decisions."""

from __future__ import annotations

import gymnasium as gym

from evaluation.scenarios.complex_roads import ComplexRoadsEnv

__all__ = ["ComplexRoadsEnv"]

if "ComplexRoads-v0" not in gym.registry:
    gym.register(id="ComplexRoads-v0", entry_point="evaluation.scenarios.complex_roads:ComplexRoadsEnv")
if "lane-keeping-half-minute-v0" not in gym.registry:
    gym.register(
        id="lane-keeping-half-minute-v0",
        entry_point="evaluation.scenarios.lane_keeping:DrawnLaneKeepingEnv",
        max_episode_steps=300,
    )
