"""A trained model, bare and behind the shield: the same `predict`, the same `evaluate_policy`.

Takes 30 s on one core.
"""

import os

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

from evaluation.policies import load_reference
from shield import Shield

EPISODES = int(os.environ.get("EPISODES", "20"))

env = Monitor(gym.make("highway-fast-v0"))
model = load_reference("ppo-highway-fast")  # or PPO.load("my-model.zip")

for name, policy in (("bare", model), ("shielded", Shield(model, env=env))):
    env.reset(seed=100_000)
    mean, std = evaluate_policy(policy, env, n_eval_episodes=EPISODES)
    print(f"{name}: return {mean:.1f} (standard deviation {std:.1f}) in {EPISODES} episodes")
