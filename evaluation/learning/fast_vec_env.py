"""`FastHighwayVecEnv`: the compiled highway for Stable-Baselines3."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

from dynamics.highway_simulator.scenario import REWARDS
from dynamics.highway_simulator.simulator import Simulator
from dynamics.scenes.registration import spec_of
from dynamics.state import IntArray
from dynamics.traffic.crossing import make
from dynamics.world_model import BirdsEye, FrameView
from shield.errors import ConfigError, MissingAttributeError

__all__ = ["FastHighwayVecEnv"]

_DIGITS = 6
"""Number of digits to which `Monitor` rounds returns and times."""


class FastHighwayVecEnv(VecEnv):
    """Batch of highways as a VecEnv, a thousand times as fast as `make_vec_env(env_id, num_envs)`.

    Observations, rewards, ends of episodes and infos are those of `DummyVecEnv` around highway-env in `Monitor`s, equal
    to the last bit, so the trained model is the same. The infos contain `terminal_observation`, `TimeLimit.truncated`
    and `episode` with the last step, and highway-env's `speed`, `crashed`, `action` and `rewards`.

    Parameters
    ----------
    num_envs, env_id, config, threads : as in `dynamics.highway_simulator.simulator.Simulator`.
    frames : observe bird's-eye frames of this view, uint8, instead of the configured observation.

    Raises
    ------
    ConfigError
        If the simulator does not support the environment; use highway-env itself then.

    Examples
    --------
    >>> from stable_baselines3 import PPO
    >>> world = FastHighwayVecEnv(4, "highway-fast-v0")
    >>> model = PPO("MlpPolicy", world, n_steps=16, batch_size=32, device="cpu").learn(64)
    """

    def __init__(
        self,
        num_envs: int = 4,
        env_id: str = "highway-fast-v0",
        config: Mapping[str, Any] | None = None,
        threads: int = 1,
        frames: FrameView | None = None,
    ) -> None:
        self.simulator = self._made(num_envs, env_id, config, threads)
        scenario, space = self.simulator.scenario, self.simulator.scenario.observation_space
        self._birds_eye: BirdsEye | None = None
        if frames is not None:
            self._birds_eye = BirdsEye(frames)
            space = self._birds_eye.space
            self._network = _network_of(env_id, config)
            self._pictures = np.zeros((num_envs, *frames.shape), np.uint8)
        self.env_id, self.config, self.spec = env_id, dict(scenario.config), spec_of(env_id)
        self.render_mode = None
        self._actions: Any = None
        self._returns = np.zeros(num_envs)
        self._lengths = np.zeros(num_envs, np.int64)
        self._start = time.time()
        super().__init__(num_envs, space, scenario.action_space)

    def _made(self, num_envs: int, env_id: str, config: Mapping[str, Any] | None, threads: int) -> Any:
        """The simulator of the environments."""
        return Simulator(env_id, num_envs, config, threads)

    def _begin(self, seeds: list[int] | None) -> Any:
        """Start all episodes, and return the observations."""
        return self.simulator.reset(seeds)

    def _stepped(self, which: IntArray) -> Any:
        """Step these environments: observations, rewards, terminated, truncated. An episode that ends is followed by
        the next one, unless frames are observed."""
        return self.simulator.step(self._actions, again=self._birds_eye is None, which=which)

    def _begin_again(self, which: IntArray) -> None:
        """Start new episodes in these environments."""
        self.simulator.reset(which=which)

    def reset(self) -> Any:
        """Start all episodes, with the seeds of `seed()` the first time."""
        seeds = self._seeds
        if all(seed is None for seed in seeds):
            observations = self._begin(None)
        else:
            observations = self._begin([int(seed or 0) for seed in seeds])
        if self._birds_eye is not None:
            observations = self._birds_eye.frames(self.simulator, self._network, self._pictures)
        self._reset_seeds()
        self._reset_options()
        self._returns[:], self._lengths[:] = 0.0, 0
        return observations.copy()

    def step_async(self, actions: Any) -> None:
        """Set the actions of the next step."""
        self._actions = np.asarray(actions)

    def step_wait(self) -> Any:
        """Step all environments; an environment is reset after the end of its episode."""
        return self._step_some(np.arange(self.num_envs))

    def step_some(self, actions: Any, which: Sequence[int] | IntArray) -> Any:
        """Step some of the environments; an environment is reset after the end of its episode.

        Parameters
        ----------
        actions : actions of all environments; those of the others are ignored, but have to be valid.
        which : indices of the environments, in increasing order.

        Returns
        -------
        As from `step`, for all environments. The others have the observation, the reward and the info of their last
        step, and False for the end of the episode.
        """
        self._actions = np.asarray(actions)
        return self._step_some(np.asarray(which, np.int64))

    def _step_some(self, which: IntArray) -> Any:
        observations, reward, terminated, truncated = self._stepped(which)
        stepped = np.zeros(self.num_envs, np.bool_)
        stepped[which] = True
        done = (terminated | truncated) & stepped
        self._returns[which] += reward[which]
        self._lengths[which] += 1
        infos = self._infos(terminated & done, done, stepped)
        self._returns[done], self._lengths[done] = 0.0, 0
        if self._birds_eye is not None:
            observations = self._frames_after(self._birds_eye, which, np.flatnonzero(done), infos)
        return observations.copy(), reward.astype(np.float32), done, infos

    def _frames_after(self, draws: BirdsEye, which: IntArray, ended: IntArray, infos: list[dict[str, Any]]) -> Any:
        """Frames after a step, with new episodes after those that ended, whose last frames become the
        `terminal_observation` of their infos."""
        frames = draws.frames(self.simulator, self._network, self._pictures, which)
        for i in ended:
            infos[i]["terminal_observation"] = frames[i].copy()
        if len(ended):
            self._begin_again(ended)
            draws.frames(self.simulator, self._network, frames, ended)
        return frames

    def _infos(self, terminated: Any, done: Any, stepped: Any) -> list[dict[str, Any]]:
        """Infos of each environment; `stepped` marks those that made the last step."""
        seen, infos = self.simulator.seen, self._info_entries()
        elapsed = round(time.time() - self._start, _DIGITS)
        for info, over, crashed in zip(infos, done, terminated, strict=True):
            info["TimeLimit.truncated"] = bool(over and not crashed)
        for i in np.flatnonzero(done):
            infos[i]["terminal_observation"] = seen.terminal[i].copy()
            total = round(float(self._returns[i]), _DIGITS)
            infos[i]["episode"] = {"r": total, "l": int(self._lengths[i]), "t": elapsed}
        return infos

    def _info_entries(self) -> list[dict[str, Any]]:
        """highway-env's own `info` of each environment."""
        seen, actions = self.simulator.seen, self._actions
        speeds, parts = seen.speed.tolist(), seen.parts.tolist()
        return [
            {
                "speed": speeds[i],
                "crashed": parts[i][0] != 0,
                "action": actions[i],
                "rewards": dict(zip(REWARDS, parts[i], strict=True)),
            }
            for i in range(self.num_envs)
        ]

    def close(self) -> None:
        """Nothing to close."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """`config`, `spec`, `render_mode`, `action_space`, `observation_space` of each environment."""
        if attr_name not in ("config", "spec", "render_mode", "action_space", "observation_space"):
            raise MissingAttributeError(
                f"a compiled environment has no {attr_name!r}; have config, spec, render_mode, action_space, "
                "observation_space, or .simulator, with the state of all of them"
            )
        return [getattr(self, attr_name) for _ in self._indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Raise `ConfigError`, because all environments share one configuration."""
        raise ConfigError(f"{attr_name!r} cannot be set on a compiled environment; make another one with config=")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Raise `MissingAttributeError`, because there are no environment objects."""
        raise MissingAttributeError(
            f"a compiled highway has no method {method_name!r}; a live one: simulator.store(gym.make({self.env_id!r}))"
        )

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: Any = None) -> list[bool]:
        """Whether infos have the form of this wrapper; they have that of `Monitor`."""
        return [issubclass(Monitor, wrapper_class) for _ in self._indices(indices)]

    def _indices(self, indices: Any) -> Iterable[int]:
        return self._get_indices(indices)


def _network_of(env_id: str, config: Mapping[str, Any] | None) -> Any:
    """The `RoadNetwork` of an environment."""
    env = make(env_id, dict(config or {}))
    try:
        env.reset(seed=0)
        base: Any = env.unwrapped
        return base.road.network
    finally:
        env.close()
