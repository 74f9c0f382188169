"""How much faster the compiled highway is than highway-env's: decisions a second, one core, in the same run.

    python benchmarks/simulator.py [--envs 64] [--rounds 5]

Random meta-actions, observations and resets included on both sides; the two are timed in turns, and the medians of the
rounds compared.
"""

from __future__ import annotations

import argparse
import time

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np

from dynamics.simulator.simulator import Simulator

SECONDS = 2.0


def rival(env_id: str, seed: int) -> float:
    """Decisions a second of highway-env."""
    env = gym.make(env_id).unwrapped
    env.reset(seed=seed)
    actions = np.random.default_rng(seed)
    start, n = time.process_time(), 0
    while time.process_time() - start < SECONDS:
        *_, terminated, truncated, _ = env.step(int(actions.integers(5)))
        n += 1
        if terminated or truncated:
            env.reset()
    return n / (time.process_time() - start)


def compiled(simulator: Simulator, seed: int) -> float:
    """Decisions a second of the compiled copy."""
    simulator.reset(range(seed, seed + simulator.num_envs))
    actions = np.random.default_rng(seed).integers(5, size=(64, simulator.num_envs))
    start, n = time.process_time(), 0
    while time.process_time() - start < SECONDS:
        simulator.step(actions[n % 64], again=True)
        n += 1
    return n * simulator.num_envs / (time.process_time() - start)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--envs", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    for env_id in ("highway-fast-v0", "highway-v0"):
        simulator = Simulator(env_id, arguments.envs)
        compiled(simulator, 0)
        pairs = [(rival(env_id, seed), compiled(simulator, seed)) for seed in range(arguments.rounds)]
        slow, fast = np.median(pairs, axis=0)
        print(f"{env_id:16s} highway-env {slow:7.1f}/s  compiled {fast:9.0f}/s  {fast / slow:6.0f} x")


if __name__ == "__main__":
    main()
