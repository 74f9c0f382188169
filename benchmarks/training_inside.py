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
DQN: dict[str, Any] = {
    "learning_rate": 5e-4,
    "buffer_size": 15_000,
    "learning_starts": 200,
    "batch_size": 64,
    "gamma": 0.9,
    "train_freq": 1,
    "gradient_steps": 8,
    "target_update_interval": 400,
    "policy_kwargs": PPO["policy_kwargs"],
}
"""A gradient step for each decision."""
ALONE = {**PPO, "policy_kwargs": {"net_arch": [64, 64]}}
ARMS: dict[str, dict[str, Any]] = {
    "proposed": {},
    "executed": {"learn_from": "executed"},
    "masks": {"masks": True},
    "rows alone": {"hyperparameters": ALONE, "normalise": ("observations", "rewards")},
    "DQN proposed": {"algorithm": "dqn", "hyperparameters": DQN, "normalise": ()},
    "DQN executed": {"algorithm": "dqn", "hyperparameters": DQN, "normalise": (), "learn_from": "executed"},
}
"""What differs from a PPO that learns from what it proposes, with `LaneFeatures`. "+X" after one is a penalty of X."""
COLUMNS = ["arm", "crashes in training", "overridden in training", "crashes", "return", "lowest seed",
           "overridden", "speed"]  # fmt: skip


class Faster:
    """Always FASTER: has the interface of a model that `drive` needs."""

    def get_vec_normalize_env(self) -> None:
        """Observations are not normalised."""

    def predict(self, observations: Any, deterministic: bool = True) -> tuple[Any, None]:
        """FASTER in each environment."""
        return np.full(len(observations), 3), None


def trained(arm: str, seed: int, steps: int, path: Path) -> Any:
    """The model of an arm, trained unless it is there."""
    name, _, penalty = arm.partition("+")
    options = {"hyperparameters": PPO, "normalise": ("rewards",), "algorithm": "ppo", **ARMS[name]}
    algorithm = options.pop("algorithm")
    if not manifest_path(path).exists():
        more = {"override_penalty": float(penalty or 0), "shield": "default", "envs": 8, "progress": False}
        train(SETTING, algorithm, steps, seed, output=path, **more, **options)
    return get_algorithm("maskableppo" if options.get("masks") else algorithm).load(path, device="cpu")


def file_of(arm: str, seed: int) -> str:
    """What the files of one model are called, without an ending."""
    return f"{arm.replace(' ', '-')}-{seed}"


def measure(arm: str, seed: int, asked: argparse.Namespace) -> pd.DataFrame:
    """Train one model, unless it is there, and drive it."""
    name = file_of(arm, seed)
    path, table = asked.out / f"{name}.zip", asked.out / f"{name}.parquet"
    if not table.exists():
        model: Any = Faster() if arm == "always FASTER" else trained(arm, seed, asked.steps, path)
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
    for file in [asked.out / f"{file_of(arm, seed)}.json" for seed in seeds]:
        if file.exists():
            manifest = json.loads(file.read_text())
            told.append({**manifest["in_training"], "steps": manifest["steps_taken"]})
    crashed, n = int(episodes["crashed"].sum()), len(episodes)
    most = clopper_pearson(crashed, n).high
    share = episodes["overridden"].sum() / episodes["steps"].sum()
    values = [
        arm,
        f"{sum(each['crashes'] for each in told)} of {sum(each['episodes'] for each in told):,}" if told else "–",
        f"{sum(each['overridden'] for each in told) / sum(each['steps'] for each in told):.1%}" if told else "–",
        f"{crashed} of {n:,} (at most {100 * most:.3f} %)",
        f"{returns.estimate:.2f} [{returns.low:.2f}, {returns.high:.2f}]",
        f"{min(group.mean() for group in groups):.2f}",
        f"{share:.1%}",
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
    parser.add_argument(
        "--arms", default=",".join(["always FASTER", *ARMS, "proposed+0.2"]), help="with commas between"
    )
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for arm in asked.arms.split(","):
        name = arm.strip()
        rows.append(row(name, asked, [0] if name == "always FASTER" else list(range(asked.seeds))))
        print(pd.DataFrame(rows).to_markdown(index=False), flush=True)


if __name__ == "__main__":
    main()
