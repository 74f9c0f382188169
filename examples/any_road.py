"""Any road of highway-env: throttle and steering on a roundabout, and four egos at an intersection.

Takes 5 s on one core.
"""

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np

import evaluation.wrappers  # noqa: F401  (registers roundabout-continuous-v1)
from shield import ShieldedEnv

env = ShieldedEnv(gym.make("roundabout-continuous-v1"))
env.reset(seed=0)
over, total = False, 0.0
while not over:
    _, reward, terminated, truncated, info = env.step(np.array([1.0, 0.0], dtype=np.float32))
    total, over = total + reward, terminated or truncated
speed = env.unwrapped.vehicle.speed
print(
    f"full throttle, the wheel straight: return {total:.1f}, {speed:.0f} m/s, crashed: {env.unwrapped.vehicle.crashed}"
)
print(f"decisions overridden: {info['shield_episode']['overridden']} of {info['shield_episode']['decisions']}")

egos = 4
env = ShieldedEnv(gym.make("intersection-multi-agent-v0", config={"controlled_vehicles": egos}))
env.reset(seed=1)
over = False
while not over:
    *_, terminated, truncated, info = env.step((2,) * egos)  # faster, all of them
    over = terminated or truncated
vehicles = env.unwrapped.controlled_vehicles
print(
    f"{egos} egos: {sum(map(env.unwrapped.has_arrived, vehicles))} arrived, {sum(v.crashed for v in vehicles)} crashed"
)
