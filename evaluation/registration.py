"""Registration of the environments of `evaluation.scenarios` with Gymnasium."""

from __future__ import annotations

from gymnasium.envs.registration import register, registry

__all__ = ["register_environments"]


def register_environments() -> None:
    """Register `ComplexRoads-v0` and `lane-keeping-half-minute-v0`, unless they are registered already.

    The latter is highway-env's lane keeping, which has no end, with a limit of 300 decisions.
    """
    if "ComplexRoads-v0" not in registry:
        register(id="ComplexRoads-v0", entry_point="evaluation.scenarios.complex_roads:ComplexRoadsEnv")
    if "lane-keeping-half-minute-v0" not in registry:
        register(
            id="lane-keeping-half-minute-v0",
            entry_point="evaluation.scenarios.lane_keeping:DrawnLaneKeepingEnv",
            max_episode_steps=300,
        )
