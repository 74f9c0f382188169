"""A shield that sees only what the policy sees, through a sensor with half a metre of noise.

Takes 13 s on one core.
"""

import os

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)

from evaluation.wrappers import SENSORS, SensorNoise
from shield import ShieldedEnv

observation = {"type": "Kinematics", "vehicles_count": 15, "see_behind": True}
env = SensorNoise(gym.make("highway-fast-v0", config={"observation": observation}), SENSORS["metric-0.5"])
env = ShieldedEnv(env, perception="observation")
for seed in range(int(os.environ.get("EPISODES", "5"))):
    env.reset(seed=seed)
    total, over = 0.0, False
    while not over:
        _, reward, terminated, truncated, info = env.step(3)  # always FASTER
        total, over = total + reward, terminated or truncated
    print(f"seed {seed}: return {total:.1f}, crashed {info['crashed']}, guarantee {info['shield']['guarantee']}")
print(f"each side of each body is within its bounds with probability {env.last_decision.level:.3f}")
