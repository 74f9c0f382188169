"""`FastRoadVecEnv`: highway-env's environments on road networks, compiled, for Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dynamics.road_networks.episodes.info import info_of
from dynamics.road_networks.episodes.simulator import RoadSimulator
from dynamics.world_model import FrameView
from evaluation.learning.fast_vec_env import FastHighwayVecEnv
from shield.errors import MissingAttributeError

__all__ = ["FastRoadVecEnv"]


class FastRoadVecEnv(FastHighwayVecEnv):
    """Batch of environments on one road network as a VecEnv, some hundred times as fast as `make_vec_env`.

    Observations, rewards, ends of episodes and infos are those of `DummyVecEnv` around highway-env in `Monitor`s, equal
    to the last bit (see `FastHighwayVecEnv`).

    Parameters
    ----------
    num_envs, env_id, config, threads : as in `dynamics.road_networks.episodes.simulator.RoadSimulator`.
    frames : as in `FastHighwayVecEnv`.

    Raises
    ------
    ConfigError
        If the simulator does not support the environment; use highway-env itself then.

    Examples
    --------
    >>> world = FastRoadVecEnv(4, "roundabout-v0")
    >>> _ = world.seed(0)
    >>> world.reset().shape
    (4, 5, 5)
    """

    def __init__(
        self,
        num_envs: int = 4,
        env_id: str = "merge-v0",
        config: Mapping[str, Any] | None = None,
        threads: int = 1,
        frames: FrameView | None = None,
    ) -> None:
        super().__init__(num_envs, env_id, config, threads, frames)

    def _made(self, num_envs: int, env_id: str, config: Mapping[str, Any] | None, threads: int) -> RoadSimulator:
        return RoadSimulator(env_id, num_envs, config, threads)

    def _info_entries(self) -> list[dict[str, Any]]:
        return [info_of(self.simulator, i, self._actions[i]) for i in range(self.num_envs)]

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Raise `MissingAttributeError`, because there are no environment objects."""
        raise MissingAttributeError(f"a compiled environment has no method {method_name!r}; take highway-env itself")
