"""Learning from the executed action, if the shield replaced the proposal."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback

from shield.errors import ConfigError

__all__ = ["LearnFromExecuted"]


class LearnFromExecuted(BaseCallback):
    """Stores each transition with the meta-action that was executed, `info["action"]`.

    On-policy (PPO, A2C, TRPO), the policy's probability of the executed action is stored with it, so the ratio of new
    to old probability is 1 before the first update. The gradient is biased, because the action was not drawn from the
    policy. Off-policy (DQN), the replay buffer holds the executed action. Q-learning accepts transitions of any policy,
    so there is no bias.

    A decision that was held back without another action is stored as proposed.

    Raises
    ------
    ConfigError
        At the start of training, if actions are not discrete.

    Notes
    -----
    Stable-Baselines3 calls `on_step` between the step and the storage, and stores the arrays in `locals`; they are
    changed in place. `replaced` counts transitions with a replaced action.
    """

    replaced = 0

    def _on_training_start(self) -> None:
        self.replaced = 0
        if not isinstance(self.training_env.action_space, gym.spaces.Discrete):
            raise ConfigError(
                "learning from executed actions needs discrete actions; this environment has "
                f"{self.training_env.action_space}, which the shield changes at each frame"
            )

    def _on_step(self) -> bool:
        shown = self.locals
        executed = np.array([_executed(info) for info in shown["infos"]])
        stored = shown["buffer_actions"] if "buffer_actions" in shown else shown["actions"]
        replaced = np.flatnonzero(executed != stored.reshape(-1))
        self.replaced += len(replaced)
        if len(replaced) == 0:
            return True
        stored.reshape(-1)[:] = executed
        if "log_probs" in shown:
            policy: Any = self.model.policy
            with torch.no_grad():
                chosen = torch.as_tensor(executed, device=self.model.device)
                _, log_probs, _ = policy.evaluate_actions(shown["obs_tensor"], chosen)
                # Other entries keep their value to the last bit.
                shown["log_probs"][replaced] = log_probs[replaced]
        return True


def _executed(info: dict[str, Any]) -> int:
    if "shield" not in info:
        raise ConfigError("learning from executed actions needs shielded environments")
    return int(info["action"])
