"""MaskablePPO asks the shield for its masks: what does not verify is not tried in the first place.

Takes 134 s on one core.
"""

import os

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.utils import get_action_masks

from shield import ShieldedEnv

steps = int(os.environ.get("STEPS", "5000"))
env = ShieldedEnv(gym.make("highway-fast-v0"))
model = MaskablePPO("MlpPolicy", env, n_steps=64, device="cpu").learn(steps)

obs, _ = env.reset(seed=100_000)
total, overridden, done = 0.0, 0, False
while not done:
    action, _ = model.predict(obs, action_masks=get_action_masks(env), deterministic=True)
    obs, reward, terminated, truncated, info = env.step(int(action))
    total, overridden, done = total + reward, overridden + info["shield"]["overridden"], terminated or truncated
print(f"return {total:.1f}, {overridden} decisions overridden")
