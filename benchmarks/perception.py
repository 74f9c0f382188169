"""What it takes to make a scene of an observation, against reading the simulator's state, on the same frames: medians.

python benchmarks/perception.py [--episodes 5]
"""

from __future__ import annotations

import argparse
from time import perf_counter
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np

from dynamics.scenes.scene import SceneReader
from evaluation.settings import get_setting
from evaluation.wrappers import SENSORS, SensorNoise
from shield.perception.scenes import ObservedScenes, sense


def measure(env: gym.Env[Any, Any], episodes: int) -> list[float]:
    """Medians of the time to read the state, to observe, and to make a scene of that [ms]."""
    base: Any = env.unwrapped
    times: list[list[float]] = [[], [], []]
    for seed in range(episodes):
        env.reset(seed=seed)
        state, scenes = SceneReader(base), ObservedScenes(env)
        scenes.check()
        state.check()
        for _ in range(40):
            start = perf_counter()
            state.read()
            read = perf_counter()
            seen = sense(env)
            observed = perf_counter()
            scenes.show(seen)
            scenes.read()
            for each, spent in zip(times, (read - start, observed - read, perf_counter() - observed), strict=True):
                each.append(1e3 * spent)
            base.road.act()
            base.road.step(0.2)
            base.steps += 1
    return [float(np.median(each)) for each in times]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=5)
    episodes = parser.parse_args().episodes
    seen = get_setting("highway-fast-seen").make()
    print("| 15 vehicles | state ms | observe ms | scene of it ms |\n| :-- | --: | --: | --: |")
    for name, env in (("exact", seen), ("metric-0.5", SensorNoise(seen, SENSORS["metric-0.5"]))):
        print(f"| {name} | " + " | ".join(f"{x:.2f}" for x in measure(env, episodes)) + " |")


if __name__ == "__main__":
    main()
