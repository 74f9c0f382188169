"""The road networks of every environment, and their `RoadGeometry`."""

from __future__ import annotations

from functools import lru_cache

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest

from dynamics.road_networks.geometry.road_geometry import RoadGeometry

COMPLEX = "evaluation.scenarios:ComplexRoads-v0"
ENVIRONMENTS = (*sorted(k for k, spec in gym.registry.items() if "highway_env" in str(spec.entry_point)), COMPLEX)
EACH = pytest.mark.parametrize("env_id", ENVIRONMENTS)


@lru_cache
def read(env_id):
    """The network of an environment, and its geometry."""
    env = gym.make(env_id)
    env.reset(seed=0)
    return env.unwrapped.road.network, RoadGeometry.of(env)


def numbers(geometry):
    return np.arange(len(geometry.names))
