"""Model predictive control on highway-env's bicycle drives by itself; the shield watches it like any other policy.

Takes 13 s on one core.
"""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)

from mpc import MPCPolicy
from shield import ShieldedEnv

config = {"action": {"type": "ContinuousAction"}, "duration": 15}
env = ShieldedEnv(gym.make("highway-v0", config=config))
policy = MPCPolicy(env)
obs, _ = env.reset(seed=100_000)
total, overridden, done = 0.0, 0, False
while not done:
    action, _ = policy.predict(obs)
    obs, reward, terminated, truncated, info = env.step(action)
    total, overridden, done = total + reward, overridden + info["shield"]["overridden"], terminated or truncated
print(f"return {total:.1f}, {overridden} decisions overridden, speed {env.unwrapped.vehicle.speed:.1f} m/s at the end")
