"""Time of a planner's rollouts (8 blocks of 4 decisions) on the learned model, on its macro-steps, and on the bicycle.

Medians of CPU time, in one process and one thread: the rollouts of a busy machine wait, but do not count.
Run: python benchmarks/macro_steps.py
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

from collections.abc import Callable
from statistics import median
from time import process_time

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import torch

from dynamics.learned.data.collect import collect
from dynamics.learned.models.bicycle import BicycleModel
from dynamics.learned.models.linear import ModelConfig
from dynamics.learned.models.model import rollout_held
from dynamics.learned.tasks import parking_state as parking
from dynamics.learned.training.distill import DistillConfig, distill
from dynamics.learned.training.fit import FitConfig, fit

BLOCKS, HOLD, RUNS = 8, 4, 30


def typical(call: Callable[[], object]) -> float:
    """Median CPU time [ms] of a call."""
    times = []
    for _ in range(RUNS):
        begin = process_time()
        call()
        times.append(process_time() - begin)
    return 1e3 * median(times)


def main() -> None:
    """Print a table."""
    torch.set_num_threads(1)
    env = gym.make("parking-v0")
    data = collect(env, None, 500, 0, state=parking.state, dt=parking.DT, episode_steps=50)
    model = fit(data, ModelConfig(), FitConfig(epochs=100)).model
    begin = process_time()
    fast = distill(model, data, DistillConfig(holds=(1, HOLD)))
    seconds = process_time() - begin
    print(f"distilled in {seconds:.1f} s; " + "; ".join(f"hold {k}: {a}" for k, a in fast.agreement.items()))
    print("| candidates | network [ms] | macro-steps [ms] | true bicycle [ms] | network / macro-steps |")
    print("| --: | --: | --: | --: | --: |")
    generator = np.random.default_rng(0)
    models = (model, fast, BicycleModel(dtype=np.float32))
    for count in (64, 128, 512):
        states = np.repeat(data.states[:1], count, axis=0).astype(np.float32)
        actions = generator.uniform(-1, 1, (count, BLOCKS, 2)).astype(np.float32)
        times = [typical(lambda m=m: rollout_held(m, states, actions, HOLD)) for m in models]  # noqa: B023
        print(f"| {count} | " + " | ".join(f"{t:.2f}" for t in times) + f" | {times[0] / times[1]:.0f} |")


if __name__ == "__main__":
    main()
