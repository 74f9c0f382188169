"""How much faster the compiled highway is than highway-env's: one core, both in the same run and in turns.

    python benchmarks/simulator.py [--envs 64] [--rounds 5] [--plot docs/images/simulator.png]

Decisions a second under random meta-actions, observations and resets included; behind the shield, always FASTER; and of
PPO while it learns, with the hyperparameters of the bundled policy and four environments. Medians of the rounds, of
processor time.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

from dynamics.highway_simulator.env import CompiledHighwayEnv
from dynamics.highway_simulator.simulator import Simulator
from evaluation.learning.fast_vec_env import FastHighwayVecEnv
from evaluation.learning.recipes import get_recipe
from evaluation.threads import one_thread
from shield import ShieldedEnv
from shield.batch.highways import ShieldedHighways

SECONDS = 2.0


def rate(step: Callable[[], int]) -> float:
    """Decisions a second of something that returns how many it has made."""
    start, n = time.process_time(), 0
    while time.process_time() - start < SECONDS:
        n += step()
    return n / (time.process_time() - start)


def one(env: Any, seed: int, action: int | None = None) -> float:
    """Of a single environment; random actions, or always the same."""
    env.reset(seed=seed)
    actions = np.random.default_rng(seed)

    def step() -> int:
        *_, terminated, truncated, _ = env.step(int(actions.integers(5)) if action is None else action)
        if terminated or truncated:
            env.reset()
        return 1

    return rate(step)


def many(simulator: Simulator, seed: int) -> float:
    """Of the compiled copy, many environments a call."""
    simulator.reset(range(seed, seed + simulator.num_envs))
    actions = np.random.default_rng(seed).integers(5, size=(64, simulator.num_envs))
    calls = iter(range(10**9))

    def step() -> int:
        simulator.step(actions[next(calls) % 64], again=True)
        return simulator.num_envs

    return rate(step)


def shielded(highways: ShieldedHighways, seed: int) -> float:
    """Of many environments behind their shields, always FASTER."""
    highways.reset(range(seed, seed + highways.num_envs))
    actions = np.full(highways.num_envs, 3)

    def step() -> int:
        highways.step(actions, again=True)
        return highways.num_envs

    return rate(step)


def learning(env: Any, steps: int) -> float:
    """Steps a second of PPO."""
    options = {**get_recipe("ppo-highway-fast").hyperparameters, "seed": 0, "device": "cpu"}
    model = PPO("MlpPolicy", env, **options)
    start = time.process_time()
    model.learn(steps)
    return model.num_timesteps / (time.process_time() - start)


def report(name: str, pairs: list[tuple[float, float]]) -> None:
    slow, fast = np.median(pairs, axis=0)
    print(f"{name:44s} highway-env {slow:8.1f}/s   compiled {fast:9.0f}/s   {fast / slow:6.0f} x", flush=True)


def plot(path: Path) -> None:
    """Throughput against environments, and against vehicles."""
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained", sharey=True)
    counts = [1, 2, 4, 8, 16, 32, 64, 128, 256]
    for env_id in ("highway-fast-v0", "highway-v0"):
        left.plot(counts, [many(Simulator(env_id, n), 0) for n in counts], "o-", label=env_id)
        vehicles = [0, 5, 10, 20, 30, 50, 80]
        made = [many(Simulator(env_id, 64, {"vehicles_count": n}), 0) for n in vehicles]
        right.plot(vehicles, made, "o-", label=env_id)
    left.set(xscale="log", yscale="log", xlabel="environments in one call", ylabel="decisions a second, one core")
    right.set(xlabel="other vehicles, 64 environments")
    for axis in (left, right):
        axis.grid(alpha=0.3)
        axis.legend()
    figure.savefig(path, dpi=120)
    print(f"wrote {path}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--envs", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--plot", type=Path)
    arguments = parser.parse_args()
    with one_thread():
        for env_id in ("highway-fast-v0", "highway-v0"):
            simulator, rival = Simulator(env_id, arguments.envs), gym.make(env_id).unwrapped
            many(simulator, 0)
            report(env_id, [(one(rival, seed), many(simulator, seed)) for seed in range(arguments.rounds)])
        theirs, mine = ShieldedEnv(gym.make("highway-fast-v0")), ShieldedEnv(CompiledHighwayEnv("highway-fast-v0"))
        one(mine, 0, 3)
        pairs = [(one(theirs, seed, 3), one(mine, seed, 3)) for seed in range(arguments.rounds)]
        report("highway-fast-v0, ShieldedEnv, FASTER", pairs)
        for env_id in ("highway-fast-v0", "highway-v0"):
            theirs, highways = ShieldedEnv(gym.make(env_id)), ShieldedHighways(env_id, arguments.envs)
            shielded(highways, 0)
            pairs = [(one(theirs, seed, 3), shielded(highways, seed)) for seed in range(arguments.rounds)]
            report(f"{env_id}, ShieldedHighways, FASTER", pairs)
        worlds = make_vec_env("highway-fast-v0", 4), FastHighwayVecEnv(4, "highway-fast-v0")
        report("highway-fast-v0, PPO learning", [(learning(worlds[0], 640), learning(worlds[1], 6400))])
    if arguments.plot:
        plot(arguments.plot)


if __name__ == "__main__":
    main()
