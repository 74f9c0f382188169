"""`RoadVectorEnv`: highway-env's environments on road networks, compiled, as a Gymnasium vector environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dynamics.errors import ConfigError
from dynamics.highway_simulator.vector_env import CompiledVectorEnv
from dynamics.road_networks.episodes.simulator import RoadSimulator

__all__ = ["RoadVectorEnv"]


class RoadVectorEnv(CompiledVectorEnv):
    """`num_envs` environments on one road network as a Gymnasium vector environment.

    An episode that ends is followed by the next in the same step. `infos["final_obs"]` and `infos["final_info"]` hold
    its last observation and info, as with Gymnasium's own vector environments in the mode `SAME_STEP`.

    Parameters
    ----------
    env_id, num_envs, config, threads : as of `RoadSimulator`.

    Examples
    --------
    >>> env = RoadVectorEnv("merge-v0", 3)
    >>> observations, infos = env.reset(seed=7)  # seeds 7, 8 and 9
    >>> observations, rewards, terminated, truncated, infos = env.step([3, 1, 4])
    >>> observations.shape, infos["speed"].shape
    ((3, 5, 5), (3,))
    """

    def __init__(
        self, env_id: str, num_envs: int = 1, config: Mapping[str, Any] | None = None, threads: int = 1
    ) -> None:
        if not isinstance(env_id, str):
            raise ConfigError(f"RoadVectorEnv(env_id, num_envs) takes the id of an environment first, not {env_id!r}")
        simulator = RoadSimulator(env_id, num_envs, config, threads)
        super().__init__(simulator, env_id, simulator.scenario.names)
