"""Running normalisation in training, folded into the policy afterwards, so that it takes raw observations."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, cast

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecNormalize

from shield.errors import ConfigError

__all__ = ["fold", "normalised"]

_VARIANCE = 1e-3
"""Added to every variance, so that an entry with little variation in training cannot dominate the others later."""


def normalised(env: gym.Env[Any, Any] | VecEnv, what: Collection[str], gamma: float) -> VecNormalize:
    """The environment with running normalisation.

    Parameters
    ----------
    env : a single environment, or a VecEnv.
    what : any of `evaluation.names.NORMALISABLE`.
    gamma : discount of the returns; rewards are divided by the returns' standard deviation.
    """
    world = env if isinstance(env, VecEnv) else DummyVecEnv([cast(Any, lambda: env)])
    return VecNormalize(
        world,
        norm_obs="observations" in what,
        norm_reward="rewards" in what,
        clip_obs=float("inf"),  # unclipped normalisation is linear, so that `fold` is exact
        gamma=gamma,
        epsilon=_VARIANCE,
    )


def fold(model: BaseAlgorithm, statistics: VecNormalize | None = None) -> None:
    """Fold the normalisation of observations from a model's training into its first layers, in place.

    W (x - mean) / sigma + b = W' x + b' with W' = W / sigma and b' = b - W' mean.

    Parameters
    ----------
    model : a model of PPO, A2C or MaskablePPO.
    statistics : the statistics; by default those of its environment.

    Raises
    ------
    ConfigError
        If the model is not an actor and critic of dense layers, or was trained without normalised observations.
    """
    policy: Any = model.policy
    env = model.get_vec_normalize_env() if statistics is None else statistics
    actor_critic = isinstance(policy, ActorCriticPolicy) or type(policy).__name__ == "MaskableActorCriticPolicy"
    if not actor_critic or not isinstance(policy.features_extractor, FlattenExtractor):
        raise ConfigError(f"normalisation can be folded into an MlpPolicy of PPO or A2C, not {type(policy).__name__}")
    if env is None or not env.norm_obs:
        raise ConfigError("this model was trained without normalised observations; have nothing to fold")
    moments: Any = env.obs_rms
    mean = torch.as_tensor(moments.mean.reshape(-1), device=policy.device)
    sigma = torch.as_tensor(np.sqrt(moments.var.reshape(-1) + env.epsilon), device=policy.device)
    first: list[Any] = [policy.mlp_extractor.policy_net[0], policy.mlp_extractor.value_net[0]]
    with torch.no_grad():
        for layer in first:
            weight = layer.weight.double() / sigma
            layer.bias.copy_(layer.bias.double() - weight @ mean)
            layer.weight.copy_(weight)
