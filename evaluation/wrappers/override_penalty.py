"""Override penalty in training."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
from gymnasium.utils import RecordConstructorArgs

from evaluation.names import check_penalty
from shield.errors import ConfigError

__all__ = ["OverridePenalty", "less_overrides"]


def less_overrides(reward: Any, overridden: Any, penalty: float) -> Any:
    """Rewards less a penalty for overridden steps.

    Parameters
    ----------
    reward : reward of one step, or of each environment (n,).
    overridden : whether the shield replaced the action or held a frame back, bool or (n,).
    penalty : penalty of a step, in units of the reward.

    Examples
    --------
    >>> less_overrides(1.0, True, 0.25)
    0.75
    """
    return reward - penalty * overridden


class OverridePenalty(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """The reward of a `ShieldedEnv`, less a penalty for each step that the shield overrode.

    Around a VecEnv, compiled or not: `evaluation.training.penalised_vec_env.PenalisedVecEnv`.

    Parameters
    ----------
    env : a `ShieldedEnv`, or wrappers around one.
    penalty : penalty of a step, in units of the reward.

    Raises
    ------
    ConfigError
        If the penalty is negative or not finite; in `step`, if there is no shield inside.

    Examples
    --------
    >>> import highway_env
    >>> from shield import ShieldedEnv
    >>> env = OverridePenalty(ShieldedEnv(gym.make("highway-fast-v0")), 0.1)
    """

    def __init__(self, env: gym.Env[Any, Any], penalty: float) -> None:
        RecordConstructorArgs.__init__(self, penalty=penalty)
        gym.Wrapper.__init__(self, env)
        self.penalty = check_penalty(penalty)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Execute one step, and deduct the penalty from its reward."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if "shield" not in info:
            raise ConfigError("OverridePenalty needs info['shield']: put it around a ShieldedEnv")
        paid = less_overrides(float(reward), info["shield"]["overridden"], self.penalty)
        return observation, paid, terminated, truncated, info
