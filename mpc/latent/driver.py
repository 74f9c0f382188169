"""`LatentDriver`: drives from frames, with the `predict` of Stable-Baselines3."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray

from dynamics.errors import ConfigError, PolicyError
from dynamics.world_model.model import LatentState, WorldModel
from mpc.latent.actor_critic import ActorCritic, action_returns

__all__ = ["LatentDriver"]


class LatentDriver:
    """Policy of a latent actor-critic, on frames.

    It is recurrent: pass the returned state to the next `predict`, and `episode_start` at the first decision of an
    episode. Without them each frame is taken for the first of an episode.

    Parameters
    ----------
    model, networks : world model, and actor and critic on its state.
    lookahead : imagined decisions by which each action is compared at every decision; 0 for the actor alone.

    Raises
    ------
    ConfigError
        If `lookahead` is negative, or the networks do not fit the model.

    Attributes
    ----------
    observation_space, action_space : of the environments that it drives.

    Examples
    --------
    >>> from dynamics.world_model.config import WorldModelConfig
    >>> from mpc.latent.actor_critic import DriverConfig
    >>> model = WorldModel(WorldModelConfig())
    >>> driver = LatentDriver(model, ActorCritic(DriverConfig(), model.config.features, model.config.actions))
    >>> action, state = driver.predict(np.zeros((5, 64, 64), np.uint8), deterministic=True)
    >>> int(action) in range(5)
    True
    """

    def __init__(self, model: WorldModel, networks: ActorCritic, lookahead: int = 0) -> None:
        if type(lookahead) is not int or lookahead < 0:
            raise ConfigError(f"lookahead is a whole number from 0 on, not {lookahead!r}")
        if networks.actor[0].in_features != model.config.features:
            raise ConfigError(
                f"the actor reads {networks.actor[0].in_features} features, the model has {model.config.features}"
            )
        self.model, self.networks, self.lookahead = model, networks, lookahead
        self.observation_space = gym.spaces.Box(0, 255, model.config.shape, np.uint8)
        self.action_space = gym.spaces.Discrete(model.config.actions)

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Actions for a frame, (channels, size, size) uint8, or for a batch of n frames.

        Parameters
        ----------
        observation : the frame or frames.
        state : what the last call returned: recurrent states after its actions, (n, recurrent); None for blank ones.
        episode_start : whether each of the n frames is the first of its episode.
        deterministic : whether to take the best action, or to sample.

        Raises
        ------
        PolicyError
            If the frames have another shape or type, or the state is of another batch.
        """
        frames, alone = self._frames(observation)
        h = self._recurrent(state, episode_start, len(frames))
        with torch.no_grad():
            now = self.model.posterior_state(h, self.model.embed(torch.from_numpy(frames)))
            scores = self._scores(now)
            if not deterministic:
                uniform = torch.rand_like(scores).clamp(1e-9)
                scores = scores - torch.log(-torch.log(uniform))
            actions = scores.argmax(-1)
            after = self.model.advance(now, actions).numpy()
        chosen = actions.numpy()
        return (chosen[0] if alone else chosen), after

    def _scores(self, now: LatentState) -> torch.Tensor:
        """Log-preferences of the actions, (n, actions), up to a constant."""
        if not self.lookahead:
            scores: torch.Tensor = self.networks.actor(now.features)
            return scores
        returns = action_returns(self.model, self.networks, now, self.lookahead, greedy=True)
        return returns / self.networks.config.temperature

    def _frames(self, observation: Any) -> tuple[NDArray[np.uint8], bool]:
        frames, shape = np.asarray(observation), self.model.config.shape
        alone = frames.ndim == len(shape)
        if frames.shape[-3:] != shape or frames.ndim not in (3, 4) or frames.dtype != np.uint8:
            raise PolicyError(
                f"a latent driver takes frames {shape} uint8, or a batch of them, not {frames.shape} {frames.dtype}; "
                "drive BirdsEyeView(env, view) with the driver's view"
            )
        return np.ascontiguousarray(frames[None] if alone else frames), alone

    def _recurrent(self, state: Any, episode_start: Any, count: int) -> torch.Tensor:
        if state is None:
            return self.model.blank(count)
        h = np.asarray(state, np.float32)
        if h.shape != (count, self.model.config.recurrent):
            raise PolicyError(
                f"the state of {count} frames has shape {(count, self.model.config.recurrent)}, not {h.shape}"
            )
        start = np.zeros(count, bool) if episode_start is None else np.broadcast_to(episode_start, (count,))
        return torch.from_numpy(np.where(start.astype(bool)[:, None], np.float32(0), h))
