"""Environments of our own. Importing the package registers ``ComplexRoads-v0`` with Gymnasium."""

from __future__ import annotations

import gymnasium as gym

from evaluation.scenarios.complex_roads import ComplexRoadsEnv

__all__ = ["ComplexRoadsEnv"]

if "ComplexRoads-v0" not in gym.registry:
    gym.register(id="ComplexRoads-v0", entry_point="evaluation.scenarios.complex_roads:ComplexRoadsEnv")
