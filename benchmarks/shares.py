"""What a decision takes, as a share of the environment's own step, on each road: verification by simulation.

    python benchmarks/shares.py [--episodes 20] [--seed 893000] [SETTING ...]

`ShieldedEnv` with meta-actions, always FASTER and random actions; both times are of the same steps.
"""

from __future__ import annotations

import argparse
from time import perf_counter

import numpy as np
import pandas as pd

from evaluation.running.named_policies import make_policy, start_episode
from evaluation.settings import get_setting
from shield import ShieldConfig, ShieldedEnv

ROADS = ("highway-fast", "highway", "merge", "roundabout", "exit", "two-way", "u-turn", "intersection")


def timed(name: str, policy: str, seeds: range) -> dict[str, object]:
    """A row: the shield's time of a decision, and of a step what is left without it [ms]."""
    env = ShieldedEnv(get_setting(name).make(), ShieldConfig.simulated_traffic())
    driver, mine, rest = make_policy(policy, env), list[float](), list[float]()
    for seed in seeds:
        obs, _ = env.reset(seed=seed)
        start_episode(driver, seed)
        done = False
        while not done:
            action = int(np.asarray(driver.predict(obs, deterministic=True)[0]).item())
            start = perf_counter()
            obs, _, terminated, truncated, _ = env.step(action)
            rest.append(1e3 * (perf_counter() - start - env.latency))
            mine.append(1e3 * env.latency)
            done = terminated or truncated
    env.close()
    step = float(np.mean(rest))
    return {
        "road": name,
        "policy": policy,
        "decisions": len(mine),
        "step ms": step,
        "shield ms": float(np.mean(mine)),
        "share": float(np.mean(mine)) / step,
        "p99 ms": float(np.percentile(mine, 99)),
        "p99 share": float(np.percentile(mine, 99)) / step,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("roads", nargs="*", default=ROADS, metavar="SETTING")
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=893_000)
    arguments = parser.parse_args()
    seeds = range(arguments.seed, arguments.seed + arguments.episodes)
    rows = [timed(road, policy, seeds) for road in arguments.roads for policy in ("faster", "random")]
    print(pd.DataFrame(rows).to_markdown(index=False, floatfmt=".2f"))


if __name__ == "__main__":
    main()
