"""Parking, planned with the Cross-Entropy Method on a learned model, behind the shield for parking lots.

Takes 7 s on one core.
"""

import os

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)

from evaluation.running.named_policies import make_policy
from shield import ShieldedEnv

env = ShieldedEnv(gym.make("parking-v0"))
policy = make_policy("cem", env)
for seed in range(100_000, 100_000 + int(os.environ.get("EPISODES", "5"))):
    obs, _ = env.reset(seed=seed)
    done = False
    while not done:
        action, _ = policy.predict(obs, deterministic=True)
        obs, _, terminated, truncated, info = env.step(action)
        done = terminated or truncated
    print(f"seed {seed}: parked {bool(info['is_success'])}, crashed {env.unwrapped.vehicle.crashed}")
