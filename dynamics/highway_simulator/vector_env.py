"""`HighwayVectorEnv`: the compiled highway as a Gymnasium vector environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from dynamics.highway_simulator.scenario import REWARDS
from dynamics.highway_simulator.simulator import Simulator
from dynamics.scenes.registration import spec_of

__all__ = ["CompiledVectorEnv", "HighwayVectorEnv"]


class CompiledVectorEnv(gym.vector.VectorEnv[Any, Any, Any]):
    """Compiled environments as a Gymnasium vector environment, for a given simulator.

    An episode that ends is followed by the next in the same step. `infos["final_obs"]` and `infos["final_info"]` hold
    its last observation and info, as with Gymnasium's own vector environments in the mode `SAME_STEP`.

    Parameters
    ----------
    simulator : a `Simulator` or `RoadSimulator`. env_id : its environment.
    names : of the terms of the reward, in the order of `simulator.seen.parts`.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(self, simulator: Any, env_id: str, names: Sequence[str]) -> None:
        scenario, num_envs = simulator.scenario, simulator.num_envs
        self.simulator, self._names = simulator, tuple(names)
        self.num_envs, self.spec, self.render_mode = num_envs, spec_of(env_id), None
        self.config = dict(scenario.config)
        self.single_observation_space, self.single_action_space = scenario.observation_space, scenario.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start all episodes. Environment i has the seed `seed + i`, or its own in a list. With
        `options["reset_mask"]`, only the environments marked there are reset."""
        chosen = list(range(self.num_envs))
        if options and "reset_mask" in options:
            chosen = np.flatnonzero(options["reset_mask"]).tolist()
        seeds = {i: seed + i if isinstance(seed, int) else None if seed is None else seed[i] for i in chosen}
        going_on = [i for i, one in seeds.items() if one is None]
        if going_on:
            self.simulator.reset(which=going_on)
        seeded = {i: one for i, one in seeds.items() if one is not None}
        if seeded:
            self.simulator.reset(list(seeded.values()), list(seeded))
        return self.simulator.seen.observations.copy(), self._infos(None)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """One decision in each environment."""
        actions = np.asarray(actions)
        observations, reward, terminated, truncated = self.simulator.step(actions, again=True)
        infos, ended = self._infos(actions), terminated | truncated
        if ended.any():
            last = np.full(self.num_envs, None, dtype=object)
            for i in np.flatnonzero(ended):
                last[i] = self.simulator.seen.terminal[i].copy()
            final = infos.copy()
            infos |= {"final_obs": last, "_final_obs": ended.copy(), "final_info": final, "_final_info": ended.copy()}
        return observations.copy(), reward.copy(), terminated.copy(), truncated.copy(), infos

    def _crashed(self) -> Any:
        """Whether each ego has crashed, (num_envs,)."""
        return self.simulator.seen.crashed.copy()

    def _infos(self, actions: Any) -> dict[str, Any]:
        """highway-env's `info` at the end of the step, before a reset."""
        seen = self.simulator.seen
        infos: dict[str, Any] = {"speed": seen.speed.copy(), "crashed": self._crashed()}
        if actions is not None:
            infos |= {"action": actions, "rewards": {n: seen.parts[:, k].copy() for k, n in enumerate(self._names)}}
        return infos | {f"_{name}": np.ones(self.num_envs, np.bool_) for name in infos}


class HighwayVectorEnv(CompiledVectorEnv):
    """`num_envs` highways as a Gymnasium vector environment.

    An episode that ends is followed by the next in the same step. `infos["final_obs"]` and `infos["final_info"]` hold
    its last observation and info, as with Gymnasium's own vector environments in the mode `SAME_STEP`.

    Parameters
    ----------
    env_id, num_envs, config, threads : as of `Simulator`.

    Examples
    --------
    >>> env = HighwayVectorEnv("highway-fast-v0", 3)
    >>> observations, infos = env.reset(seed=7)  # seeds 7, 8 and 9
    >>> observations, rewards, terminated, truncated, infos = env.step([3, 1, 4])
    >>> observations.shape, infos["speed"].shape
    ((3, 5, 5), (3,))
    """

    def __init__(
        self,
        env_id: str = "highway-fast-v0",
        num_envs: int = 1,
        config: Mapping[str, Any] | None = None,
        threads: int = 1,
    ) -> None:
        super().__init__(Simulator(env_id, num_envs, config, threads), env_id, REWARDS)

    def _crashed(self) -> Any:
        return self.simulator.seen.parts[:, 0] != 0
