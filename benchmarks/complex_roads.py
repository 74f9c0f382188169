"""How policies that need no training fare on ComplexRoads-v0: crashes, arrivals, time on the lane.

python benchmarks/complex_roads.py [--episodes 50] [--duration 60]
"""

from __future__ import annotations

import argparse

import gymnasium as gym
import pandas as pd

import evaluation.scenarios  # noqa: F401  (registers the environment)
from evaluation.measuring.statistics import Interval, bootstrap_mean, wilson
from evaluation.running.named_policies import make_policy, start_episode
from evaluation.wrappers import PerformanceLogger

FIRST_SEED = 100_000
ACTIONS = {
    "throttle and steering, 5×9": {"type": "DiscreteAction", "actions_per_axis": [5, 9]},
    "meta-actions, 0 to 12 m/s": {"type": "DiscreteMetaAction", "target_speeds": [0, 4, 8, 12]},
}


def drive(action: dict[str, object], policy: str, episodes: int, duration: float) -> pd.DataFrame:
    """A row for each episode."""
    config = {"action": action, "duration": duration, "random_start": True}
    env = PerformanceLogger(gym.make("ComplexRoads-v0", config=config))
    observation, _ = env.reset(seed=FIRST_SEED)
    driver = make_policy(policy, env)
    for seed in range(FIRST_SEED, FIRST_SEED + episodes):
        observation, _ = env.reset(seed=seed)
        start_episode(driver, seed)
        done = False
        while not done:
            choice, _ = driver.predict(observation)
            observation, _, terminated, truncated, _ = env.step(int(choice))
            done = terminated or truncated
    return env.episodes()


def percent(interval: Interval) -> str:
    """A rate with its interval."""
    low, high = 100 * interval.low, 100 * interval.high
    return f"{100 * interval.estimate:.0f} [{low:.0f}, {high:.0f}]"


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument("--duration", type=float, default=60.0)
    asked = parser.parse_args()
    print("| actions | policy | crashed % | arrived % | time on the lane % | speed m/s | return |", flush=True)
    print("| :-- | :-- | --: | --: | --: | --: | --: |", flush=True)
    for label, action in ACTIONS.items():
        for policy in ("idle", "random"):
            table = drive(action, policy, asked.episodes, asked.duration)
            cells = (
                label,
                policy,
                percent(wilson(int((table["total_collisions"] > 0).sum()), len(table))),
                percent(wilson(int(table["success"].astype(bool).sum()), len(table))),
                percent(bootstrap_mean(table["on_lane_rate"])),
                f"{table['mean_speed'].mean():.1f}",
                f"{table['total_reward'].mean():.1f}",
            )
            print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
