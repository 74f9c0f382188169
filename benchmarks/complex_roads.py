"""How policies fare on ComplexRoads-v0: crashes, arrivals, time on the lane.

python benchmarks/complex_roads.py [--episodes 50] [--duration 60]            # what needs no training
python benchmarks/complex_roads.py --shielded [--episodes 100] [--seed 100000] # bare, and behind the exact shield
"""

from __future__ import annotations

import argparse
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd

import evaluation.scenarios  # noqa: F401  (registers the environment)
from evaluation.measuring.statistics import Interval, bootstrap_mean, wilson
from evaluation.running.named_policies import make_policy, start_episode
from evaluation.wrappers import PerformanceLogger
from shield import Shield, ShieldConfig

FIRST_SEED = 100_000
ACTIONS = {
    "throttle and steering, 5×9": {"type": "DiscreteAction", "actions_per_axis": [5, 9]},
    "meta-actions, 0 to 12 m/s": {"type": "DiscreteMetaAction", "target_speeds": [0, 4, 8, 12]},
}


DRIVING = {
    "action": {"type": "DiscreteMetaAction", "target_speeds": [0, 5, 10, 15]},
    "policy_frequency": 1,
    "duration": 120,
}
"""What is driven bare and behind the shield."""


def drive(config: dict[str, Any], policy: str, episodes: int, first: int, shielded: bool = False) -> pd.DataFrame:
    """A row for each episode."""
    env = PerformanceLogger(gym.make("ComplexRoads-v0", config={"random_start": True, **config}))
    observation, _ = env.reset(seed=first)
    proposing = make_policy(policy, env)
    driver: Any = Shield(proposing, env, ShieldConfig.simulated_traffic(), frames=False) if shielded else proposing
    for seed in range(first, first + episodes):
        observation, _ = env.reset(seed=seed)
        start_episode(proposing, seed)
        done = False
        while not done:
            choice, _ = driver.predict(observation, deterministic=True)
            observation, _, terminated, truncated, _ = env.step(int(np.asarray(choice).item()))
            done = terminated or truncated
    return env.episodes()


def percent(interval: Interval) -> str:
    """A rate with its interval."""
    low, high = 100 * interval.low, 100 * interval.high
    return f"{100 * interval.estimate:.1f} [{low:.1f}, {high:.1f}]"


def row(label: str, policy: str, table: pd.DataFrame) -> str:
    """Of a table in Markdown."""
    cells = (
        label,
        policy,
        percent(wilson(int((table["total_collisions"] > 0).sum()), len(table))),
        percent(wilson(int(table["success"].astype(bool).sum()), len(table))),
        percent(bootstrap_mean(table["on_lane_rate"])),
        f"{table['mean_speed'].mean():.1f}",
        f"{table['total_reward'].mean():.1f}",
    )
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument("--duration", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=FIRST_SEED)
    parser.add_argument("--shielded", action="store_true")
    asked = parser.parse_args()
    first = "shield" if asked.shielded else "actions"
    print(f"| {first} | policy | crashed % | arrived % | time on the lane % | speed m/s | return |", flush=True)
    print("| :-- | :-- | --: | --: | --: | --: | --: |", flush=True)
    if asked.shielded:
        for policy in ("faster", "random"):
            for shielded in (False, True):
                table = drive(DRIVING, policy, asked.episodes, asked.seed, shielded)
                print(row("exact" if shielded else "none", policy, table), flush=True)
        return
    for label, action in ACTIONS.items():
        for policy in ("idle", "random"):
            table = drive({"action": action, "duration": asked.duration}, policy, asked.episodes, asked.seed)
            print(row(label, policy, table), flush=True)


if __name__ == "__main__":
    main()
