"""PPO trained inside the shield on highway-fast, in several ways, each with several training seeds:
`python benchmarks/training_inside.py --out runs/training-inside`. What is finished in that folder is not done again."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from evaluation import ShieldedVecEnv, train
from evaluation.learning.algorithms import get_algorithm
from evaluation.learning.manifests import manifest_path
from evaluation.measuring.statistics import clopper_pearson, nested_bootstrap
from evaluation.threads import one_thread
from evaluation.training.periodic_evaluation import drive

SETTING, ENV = "highway-fast", "highway-fast-v0"
LANES = "evaluation.learning.lane_features.LaneFeatures"
PPO: dict[str, Any] = {
    "n_steps": 64,
    "batch_size": 64,
    "n_epochs": 10,
    "gamma": 0.9,
    "learning_rate": 5e-4,
    "policy_kwargs": {"net_arch": [64, 64], "features_extractor_class": LANES},
}
"""Chosen on training seeds 0 and 1, 400 episodes each of seeds from 5,000."""
ROWS_ALONE = {**PPO, "policy_kwargs": {"net_arch": [64, 64]}}
ARMS: dict[str, dict[str, Any]] = {
    "proposed": {},
    "executed": {"learn_from": "executed"},
    "penalty 0.1": {"override_penalty": 0.1},
    "penalty 0.2": {"override_penalty": 0.2},
    "executed, penalty 0.2": {"learn_from": "executed", "override_penalty": 0.2},
    "masks": {"masks": True},
    "proposed, rows alone": {"hyperparameters": ROWS_ALONE, "normalise": ("observations", "rewards")},
}
"""What differs from a PPO that learns from what it proposes, with `LaneFeatures` and without a penalty."""
COLUMNS = ["arm", "crashes in training", "decisions overridden in training", "crashes", "return", "lowest seed",
           "overridden", "speed"]  # fmt: skip


class Faster:
    """Always FASTER: has the interface of a model that `drive` needs."""

    def get_vec_normalize_env(self) -> None:
        """Observations are not normalised."""

    def predict(self, observations: Any, deterministic: bool = True) -> tuple[Any, None]:
        """FASTER in each environment."""
        return np.full(len(observations), 3), None


def measure(arm: str, seed: int, asked: argparse.Namespace) -> pd.DataFrame:
    """Train one model, unless it is there, and drive it."""
    name = f"{arm.replace(', ', '-').replace(' ', '-')}-{seed}"
    path, table = asked.out / f"{name}.zip", asked.out / f"{name}.parquet"
    if not table.exists():
        if arm == "always FASTER":
            model: Any = Faster()
        else:
            options = {"hyperparameters": PPO, "normalise": ("rewards",), **ARMS[arm]}
            if not manifest_path(path).exists():
                train(
                    SETTING, "ppo", asked.steps, seed, output=path, envs=8, shield="default", progress=False, **options
                )
            algorithm = "maskableppo" if ARMS[arm].get("masks") else "ppo"
            model = get_algorithm(algorithm).load(path, device="cpu")
        with one_thread():
            driven = drive(model, ShieldedVecEnv(50, ENV), asked.episodes, asked.first)
        driven.to_parquet(table)
    return pd.read_parquet(table).assign(training_seed=seed)


def row(arm: str, asked: argparse.Namespace, seeds: list[int]) -> dict[str, Any]:
    """What is said of an arm."""
    episodes = pd.concat([measure(arm, seed, asked) for seed in seeds])
    groups = [group["return"].to_numpy() for _, group in episodes.groupby("training_seed")]
    returns = nested_bootstrap(groups)
    told = []
    for file in [asked.out / f"{arm.replace(', ', '-').replace(' ', '-')}-{seed}.json" for seed in seeds]:
        if file.exists():
            told.append(json.loads(file.read_text())["in_training"])
    crashed, n = int(episodes["crashed"].sum()), len(episodes)
    most = clopper_pearson(crashed, n).high
    share = episodes["overridden"].sum() / episodes["steps"].sum()
    values = [
        arm,
        f"{sum(each['crashes'] for each in told)} of {sum(each['episodes'] for each in told):,}" if told else "–",
        f"{sum(each['overridden'] for each in told):,}" if told else "–",
        f"{crashed} of {n:,} (at most {100 * most:.3f} %)",
        f"{returns.estimate:.2f} [{returns.low:.2f}, {returns.high:.2f}]",
        f"{min(group.mean() for group in groups):.2f}",
        f"{100 * share:.1f} %",
        f"{(episodes['speed'] * episodes['steps']).sum() / episodes['steps'].sum():.1f}",
    ]
    return dict(zip(COLUMNS, values, strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs", "training-inside"))
    parser.add_argument("--steps", type=int, default=30_000)
    parser.add_argument("--seeds", type=int, default=10, help="training seeds, from 0")
    parser.add_argument("--episodes", type=int, default=1000, help="of each model")
    parser.add_argument("--first", type=int, default=5000, help="seed of the first episode")
    parser.add_argument("--arms", default=",".join(["always FASTER", *ARMS]).replace(", ", "; "), help="separated by ,")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for arm in asked.arms.split(","):
        name = arm.strip().replace("; ", ", ")
        rows.append(row(name, asked, [0] if name == "always FASTER" else list(range(asked.seeds))))
        print(pd.DataFrame(rows).to_markdown(index=False), flush=True)


if __name__ == "__main__":
    main()
