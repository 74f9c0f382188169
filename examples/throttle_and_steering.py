"""Throttle and steering: where an input does not verify, the nearest one that does takes its place.

Takes 9 s on one core.
"""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np

from shield import ShieldedEnv

config = {"action": {"type": "ContinuousAction"}, "duration": 20}
env = ShieldedEnv(gym.make("highway-v0", config=config))
env.reset(seed=100_000)
done, distances = False, []
while not done:
    proposed = np.array([1.0, 0.0], np.float32)  # full throttle, the wheel straight
    _, _, terminated, truncated, info = env.step(proposed)
    distances.append(np.abs(np.asarray(env.last_decision.executed) - proposed).max())
    done = terminated or truncated
changed = max(distances) / 2  # inputs range from -1 to 1
print(f"crashed: {env.unwrapped.vehicle.crashed}, greatest change of an input: {changed:.0%} of its range")
