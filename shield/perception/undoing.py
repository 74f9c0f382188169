"""From what reaches a policy back to what its environment has shown."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["as_shown"]


def as_shown(env: Any, observation: Any) -> Any:
    """An observation, or a batch of them, with `VecNormalize` undone, and the latest of those that are stacked.

    Parameters
    ----------
    env : what the policy's observations come from: a Gymnasium environment, or a VecEnv.
    """
    from stable_baselines3.common.vec_env import VecEnvWrapper, VecFrameStack, VecNormalize

    while isinstance(env, VecEnvWrapper):
        if isinstance(env, VecNormalize):
            observation = env.unnormalize_obs(observation) if env.norm_obs else observation
        elif isinstance(env, VecFrameStack):
            last = env.venv.observation_space.shape[-1]  # type: ignore[index]
            observation = np.asarray(observation)[..., -last:]
        env = env.venv
    return observation
