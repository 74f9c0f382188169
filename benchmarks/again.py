"""Those episodes of a run of `shield certify` in which a fallback acted, driven again by the code as it is now, and
some of the others: what only changes the fallbacks leaves them the same to the bit.

python benchmarks/again.py runs/abz runs/abz-again.parquet
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pandas as pd
import tomli_w

from evaluation.measuring.statistics import bootstrap_mean, clopper_pearson
from evaluation.running.batch_episodes import Many
from evaluation.settings import get_setting
from shield.config import ShieldConfig

PART = 1_000
SAME = ["crashed", "return", "steps", "overridden", "frames_overridden", "violations", "min_margin", "min_gap"]


def drive(setting: str, policy: str, config: ShieldConfig, seeds: list[int]) -> pd.DataFrame:
    """A part of them."""
    return Many(get_setting(setting), policy, config).run(seeds)


def again(before: pd.DataFrame, asked: dict[str, Any], jobs: int) -> pd.DataFrame:
    """The same episodes, driven again."""
    config, seeds = ShieldConfig.from_toml(tomli_w.dumps(*asked["shields"].values())), before["seed"].tolist()
    parts = [seeds[i : i + PART] for i in range(0, len(seeds), PART)]
    each = joblib.delayed(drive)
    setting, policy = str(before["setting"].iloc[0]), next(iter(asked["policies"].values()))["name"]
    return pd.concat(joblib.Parallel(n_jobs=jobs)(each(setting, policy, config, part) for part in parts))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("output", type=Path, help="a .parquet of all episodes, those that were driven again replaced")
    parser.add_argument("--others", type=int, default=1_000)
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    asked = json.loads((given.run / "manifest.json").read_text(encoding="utf-8"))["asked"]
    episodes = pd.read_parquet(given.run / "episodes.parquet")
    acted = episodes["fallbacks"] > 0
    others = episodes[~acted].sample(min(given.others, int((~acted).sum())), random_state=0)
    same = again(others, asked, given.jobs)
    pair = (each[SAME].to_numpy(float) for each in (same, others))
    differ = ~np.isclose(*pair, rtol=0, atol=0, equal_nan=True).all(axis=1)
    now = again(episodes[acted], asked, given.jobs)
    changed = (now["return"].to_numpy() != episodes.loc[acted, "return"].to_numpy()).sum()
    result = pd.concat([episodes[~acted], now]).sort_values("seed")
    result.to_parquet(given.output, index=False)
    n, crashes, steps = len(result), int(result["crashed"].sum()), result["steps"].sum()
    bound, mean = clopper_pearson(crashes, n), bootstrap_mean(result["return"].to_numpy())
    print(f"without a fallback: {differ.sum()} of {len(others):,} differ")
    print(f"with one: {changed:,} of {acted.sum():,} differ; crashed before {episodes['crashed'].sum()}")
    print(f"all {n:,}: {crashes} crashed, at most {bound.high:.1e}: {result.loc[result['crashed'], 'seed'].tolist()}")
    print(
        f"return {mean.estimate:.3f} [{mean.low:.3f}, {mean.high:.3f}]; overridden "
        f"{100 * result['overridden'].sum() / steps:.1f} %; smallest clearance {result['min_gap'].min():.2f} m, before "
        f"{episodes['min_gap'].min():.2f}; offences {np.sum(result['violations']):,}; "
        f"a fallback in {(result['fallbacks'] > 0).sum():,}"
    )


if __name__ == "__main__":
    main()
