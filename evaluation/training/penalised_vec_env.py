"""`PenalisedVecEnv`: shielded environments with an override penalty."""

from __future__ import annotations

from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from evaluation.names import check_penalty
from evaluation.wrappers.override_penalty import less_overrides
from shield.errors import ConfigError

__all__ = ["PenalisedVecEnv"]


class PenalisedVecEnv(VecEnvWrapper):
    """Rewards less a penalty for each overridden step; `info["episode"]` keeps the environment's return.

    Parameters
    ----------
    venv : `ShieldedVecEnv`, or a `DummyVecEnv` of `ShieldedEnv`s.
    penalty : penalty of a step, in units of the reward.

    Raises
    ------
    ConfigError
        If the penalty is negative or not finite; in `step`, if there is no shield inside.

    Examples
    --------
    >>> from evaluation.learning.shielded_vec_env import ShieldedVecEnv
    >>> world = PenalisedVecEnv(ShieldedVecEnv(2, "highway-fast-v0"), 0.1)
    """

    def __init__(self, venv: VecEnv, penalty: float) -> None:
        super().__init__(venv)
        self.penalty = check_penalty(penalty)

    def reset(self) -> Any:
        """Start all episodes."""
        return self.venv.reset()

    def step_wait(self) -> Any:
        """Step all environments."""
        observations, rewards, dones, infos = self.venv.step_wait()
        if any("shield" not in info for info in infos):
            raise ConfigError("PenalisedVecEnv needs infos with 'shield': put it around shielded environments")
        overridden = np.array([info["shield"]["overridden"] for info in infos])
        paid = less_overrides(rewards, overridden, self.penalty).astype(np.float32)
        return observations, paid, dones, infos
