"""The compiled networks against highway-env on the same scenes in the same run: decisions of random meta-actions, their
frames alone (no observation and no reward on either side), and whole ones, with `CompiledFrames` around highway-env.

    python benchmarks/networks.py [--episodes 20]
"""

from __future__ import annotations

import argparse
import warnings
from time import perf_counter

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np

from dynamics.networks.compiled_frames import CompiledFrames
from dynamics.networks.simulator import NetworkSimulator

IDS = (
    *("merge-v0", "merge-generic-v0", "roundabout-v0", "roundabout-generic-v0", "exit-v0", "two-way-v0", "u-turn-v0"),
    "intersection-v0",
)


def measure(env_id: str, episodes: int) -> tuple[float, float, int]:
    """Seconds of highway-env and of the compiled network, and the number of decisions."""
    env = gym.make(env_id).unwrapped
    theirs = ours = 0.0
    count = 0
    for seed in range(episodes):
        env.reset(seed=seed)
        simulator, rng = NetworkSimulator(env), np.random.default_rng(seed)
        while not env.vehicle.crashed and env.time < 10:
            action = int(rng.integers(env.action_space.n))
            env.time += 1 / env.config["policy_frequency"]
            start = perf_counter()
            env._simulate(action)
            middle = perf_counter()
            simulator.step(action)
            ours += perf_counter() - middle
            theirs += middle - start
            count += 1
    return theirs, ours, count


def measure_whole(env_id: str, episodes: int) -> tuple[float, float, int]:
    """The same of whole decisions: observation, reward, and who comes and goes included."""
    plain, compiled = gym.make(env_id), CompiledFrames(gym.make(env_id))
    theirs = ours = 0.0
    count = 0
    for seed in range(episodes):
        plain.reset(seed=seed)
        compiled.reset(seed=seed)
        rng, over = np.random.default_rng(seed), False
        while not over and count < 40 * (seed + 1):
            action = int(rng.integers(plain.action_space.n))
            start = perf_counter()
            plain.step(action)
            middle = perf_counter()
            _, _, terminated, truncated, _ = compiled.step(action)
            ours += perf_counter() - middle
            theirs += middle - start
            count += 1
            over = terminated or truncated
    return theirs, ours, count


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=20)
    episodes = parser.parse_args().episodes
    warnings.filterwarnings("ignore", category=DeprecationWarning)
    measure(IDS[0], 1)
    measure_whole(IDS[0], 1)
    print(
        "| environment | frames: highway-env ms | compiled ms | ratio | whole: highway-env ms | compiled ms | ratio |"
    )
    print("| :-- | --: | --: | --: | --: | --: | --: |")
    for env_id in IDS:
        cells = []
        for theirs, ours, count in (measure(env_id, episodes), measure_whole(env_id, episodes)):
            cells += [f"{1e3 * theirs / count:.1f}", f"{1e3 * ours / count:.2f}", f"{theirs / ours:.0f}"]
        print(f"| {env_id} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
