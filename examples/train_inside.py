"""PPO learns inside the shield: it never crashes on the way, and sees in `info` what was overridden."""

import os

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from shield import ShieldedEnv


class Overrides(BaseCallback):
    """Logs the share of decisions that the shield replaced, to TensorBoard where one is set up."""

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            self.logger.record_mean("shield/overridden", float(info["shield"]["overridden"]))
        return True


steps = int(os.environ.get("STEPS", "5000"))
model = PPO("MlpPolicy", ShieldedEnv(gym.make("highway-fast-v0")), n_steps=64, device="cpu", verbose=1)
model.learn(steps, callback=Overrides())
model.save("runs/trained-inside")
