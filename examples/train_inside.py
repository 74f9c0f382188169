"""PPO learns inside the shield: the log shows what was overridden, and why (TensorBoard too, where one is set up).

Takes 132 s on one core.
"""

import os

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
from stable_baselines3 import PPO

from shield import ShieldCallback, ShieldedEnv

steps = int(os.environ.get("STEPS", "5000"))
model = PPO("MlpPolicy", ShieldedEnv(gym.make("highway-fast-v0")), n_steps=64, device="cpu", verbose=1)
model.learn(steps, callback=ShieldCallback())
model.save("runs/trained-inside")
