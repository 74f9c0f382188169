"""What the default shield costs and saves: crash rate and return of each environment with meta-actions, bare and behind
`ShieldedEnv(env)`, on the same seeds.

    python benchmarks/default_drives.py --episodes 1000 --seed 920000  # the table of docs/lab/what-it-drives.md
    python benchmarks/default_drives.py merge-v0 intersection-v2 --episodes 200 --seed 5000
    python benchmarks/default_drives.py merge-v0 roundabout-v0 --traffic aggressive

`short_tables.py` writes the rows of docs/what-it-drives.md from that table.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import pandas as pd
from what_it_drives import config_of, env_ids

from evaluation.measuring.statistics import wilson
from evaluation.running.batch_episodes import Many
from evaluation.running.episodes import run_paired
from evaluation.running.records import ShieldVariant
from evaluation.settings import TRAFFIC, Setting
from shield.config import ShieldConfig
from shield.decision import Verification
from shield.errors import ConfigError, ShieldError
from shield.wrappers.shielded_env import ShieldedEnv

POLICIES = ("faster", "random")


class Row(NamedTuple):
    """One environment and policy: what it is verified against, and the episodes, bare and shielded."""

    env_id: str
    verification: Verification
    policy: str
    bare: pd.DataFrame
    shielded: pd.DataFrame


def episodes(setting: Setting, policy: str, variant: ShieldVariant, seeds: range, jobs: int) -> pd.DataFrame:
    """Episodes bare or behind the default shield: side by side where they are compiled so, else one by one."""
    config = ShieldConfig(mode="none") if variant.placement == "none" else variant.config
    try:
        return Many(setting, policy, config).run(seeds)
    except ConfigError:
        return run_paired(setting, policy, [variant], seeds, simulator="auto", jobs=jobs)


def rows(env_ids: Sequence[str], traffic: str | None, seeds: range, jobs: int) -> Iterator[Row]:
    """A row for each environment that highway-env drives with meta-actions of one ego, and policy."""
    for env_id in env_ids:
        config = config_of(env_id, "DiscreteMetaAction")
        if config is None:
            continue
        setting = Setting(env_id, env_id, config).with_traffic(traffic)
        try:
            # As the runner makes it: highway-env's intersections change the traffic of the process.
            shield = ShieldedEnv(setting.make())
        except (ShieldError, TypeError, ValueError, KeyError):
            continue
        if shield.verification not in (Verification.SIMULATED, Verification.WORST_CASE) or "multi-agent" in env_id:
            continue
        for policy in POLICIES:
            bare = episodes(setting, policy, ShieldVariant(), seeds, jobs)
            behind = episodes(setting, policy, ShieldVariant("env", shield.config), seeds, jobs)
            yield Row(env_id, shield.verification, policy, bare, behind)


def crashes(frame: pd.DataFrame) -> str:
    """The crash rate [%] with its Wilson interval."""
    rate = wilson(int(frame.crashed.sum()), len(frame))
    return f"{100 * rate.estimate:.1f} [{100 * rate.low:.1f}, {100 * rate.high:.1f}]"


def line(row: Row) -> str:
    """A row in Markdown; returns and crash rates that miss are bold, with the seeds of crashes."""
    better = row.shielded["return"].mean() >= row.bare["return"].mean() - 0.005
    returned, crashed = f"{row.shielded['return'].mean():.2f}", crashes(row.shielded)
    seeds = ", ".join(map(str, row.shielded.seed[row.shielded.crashed]))
    cells = [
        row.env_id,
        row.verification.value.replace("_", " "),
        row.policy,
        crashes(row.bare),
        f"{row.bare['return'].mean():.2f}",
        f"**{crashed}** ({seeds})" if seeds else crashed,
        returned if better else f"**{returned}**",
        f"{row.shielded.mean_speed.mean():.1f}",
        f"{100 * row.shielded.overridden.sum() / row.shielded.steps.sum():.1f}",
    ]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("env_ids", nargs="*", help="all by default")
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=920_000)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--traffic", choices=sorted(TRAFFIC), help="by default the environment's own")
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    print(
        "| environment | verified against | policy | bare: crashes %; 95 % Wilson | return "
        "| default: crashes %; 95 % Wilson | return | speed m/s | overridden % |"
    )
    print("| :-- | :-- | :-- | --: | --: | --: | --: | --: | --: |")
    seeds = range(asked.seed, asked.seed + asked.episodes)
    for row in rows(asked.env_ids or env_ids(), asked.traffic, seeds, asked.jobs):
        print(line(row), flush=True)


if __name__ == "__main__":
    main()
