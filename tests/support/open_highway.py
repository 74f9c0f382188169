"""A highway for throttle and steering without other vehicles."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)

CONTINUOUS = {"action": {"type": "ContinuousAction"}, "vehicles_count": 0, "offroad_terminal": False}


def highway(**config: Any) -> gym.Env[Any, Any]:
    return gym.make("highway-fast-v0", config={**CONTINUOUS, **config})
