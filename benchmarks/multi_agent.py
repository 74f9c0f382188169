"""Several egos at the intersection, all bare or all shielded, on the same seeds.

python benchmarks/multi_agent.py --episodes 300 --egos 4
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from evaluation.measuring.statistics import wilson
from evaluation.settings import Setting
from shield import ShieldConfig, ShieldedEnv

FASTER = 2


def drive(env_id: str, egos: int, policy: str, shielded: bool, seed: int) -> tuple[bool, bool, bool, int, int, int]:
    """Whether an ego crashed, whether two egos did into one another, whether all arrived, and how many; decisions of
    single egos, and how many were overridden."""
    env: Any = Setting(env_id, env_id, {"controlled_vehicles": egos}).make()
    if shielded:
        env = ShieldedEnv(env, ShieldConfig.simulated_traffic())
    env.reset(seed=seed)
    base, rng, over = env.unwrapped, np.random.default_rng(seed), False
    arrived, decisions, overridden = np.zeros(egos, bool), 0, 0
    while not over:
        actions = [FASTER] * egos if policy == "faster" else rng.integers(3, size=egos).tolist()
        *_, truncated, info = env.step(tuple(actions))
        over = base._is_terminated() or truncated
        arrived |= [base.has_arrived(vehicle) for vehicle in base.controlled_vehicles]
        decisions += egos
        overridden += sum(each["overridden"] for each in info["shield"]["agents"]) if shielded else 0
    crashed = [vehicle for vehicle in base.controlled_vehicles if vehicle.crashed]
    near = [np.hypot(*(a.position - b.position)) < 8 for a in crashed for b in crashed if a is not b]
    return bool(crashed), any(near), bool(arrived.all()), int(arrived.sum()), decisions, overridden


def share(hits: int, total: int) -> str:
    """A rate in percent, with its 95 % Wilson interval."""
    interval = wilson(hits, total)
    return f"{100 * hits / total:.1f} [{100 * interval.low:.1f}, {100 * interval.high:.1f}]"


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--env-id", default="intersection-multi-agent-v0")
    parser.add_argument("--egos", type=int, default=2)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--seed", type=int, default=770_000)
    parser.add_argument("--jobs", type=int, default=-1)
    asked = parser.parse_args()
    print(
        "| egos | policy | shield | episodes | crashes % | egos into one another % | all arrive % | egos that arrive % "
        "| overridden % |"
    )
    print("| --: | :-- | :-- | --: | --: | --: | --: | --: | --: |")
    for policy in ("faster", "random"):
        for shielded in (False, True):
            seeds = range(asked.seed, asked.seed + asked.episodes)
            rows = Parallel(n_jobs=asked.jobs)(
                delayed(drive)(asked.env_id, asked.egos, policy, shielded, seed) for seed in seeds
            )
            crashed, into, all_of_them, arrived, decisions, overridden = map(sum, zip(*rows, strict=True))
            rates = " | ".join(share(each, len(rows)) for each in (crashed, into, all_of_them))
            rates += f" | {100 * arrived / (asked.egos * len(rows)):.1f}"
            egos = "all" if shielded else "none"
            print(
                f"| {asked.egos} | {policy} | {egos} | {len(rows)} | {rates} | {100 * overridden / decisions:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
