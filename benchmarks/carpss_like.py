"""A DQN like that of CARPSS (norm-supervised-highway: 4 lanes, 20 vehicles), trained here, bare and behind the shield:
`python benchmarks/carpss_like.py --episodes 500 --seed 978000`."""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

from evaluation import Setting, evaluate, train

SETTING = Setting("carpss-like", "highway-fast-v0", {"lanes_count": 4, "vehicles_count": 20, "duration": 40})
DQN = {
    "learning_rate": 5e-4,
    "buffer_size": 15_000,
    "learning_starts": 200,
    "batch_size": 32,
    "gamma": 0.8,
    "train_freq": 1,
    "gradient_steps": 1,
    "target_update_interval": 50,
    "policy_kwargs": {"net_arch": [256, 256]},
}
"""As of highway-env's own example."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=500)
    parser.add_argument("--seed", type=int, default=5000)
    parser.add_argument("--steps", type=int, default=20_000, help="of training")
    options = parser.parse_args()
    with TemporaryDirectory() as folder:
        path = Path(folder, "dqn-carpss-like.zip")
        train(SETTING, "dqn", options.steps, 0, output=path, hyperparameters=DQN, progress=False)
        print(evaluate(path, SETTING, episodes=options.episodes, seed=options.seed, jobs=-1))


if __name__ == "__main__":
    main()
