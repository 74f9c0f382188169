"""What it takes to make a scene of an observation that shows 15 others, decoding, following and bounding them, against
reading the simulator's state, on the same frames: medians.

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
from evaluation.wrappers import SENSORS, SensorNoise
from shield.perception.scenes import ObservedScenes, observe_now

SHOWN = 15
"""Frames that show so many others count."""
OBSERVED = {"type": "Kinematics", "vehicles_count": SHOWN + 1, "see_behind": True}
CROWDED = {"observation": OBSERVED, "vehicles_count": 20, "vehicles_density": 2.0}


def measure(env: gym.Env[Any, Any], episodes: int) -> tuple[list[float], int]:
    """Medians of the time to read the state, to observe, and to make a scene of that [ms], and of how many frames."""
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
            seen = observe_now(env)
            observed = perf_counter()
            scenes.show(seen)
            scenes.read()
            made = perf_counter()
            if len(scenes.perception.tracks.ids) >= SHOWN:
                for each, spent in zip(times, (read - start, observed - read, made - observed), strict=True):
                    each.append(1e3 * spent)
            base.road.act()
            base.road.step(0.2)
            base.steps += 1
    return [float(np.median(each)) for each in times], len(times[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=5)
    episodes = parser.parse_args().episodes
    env = gym.make("highway-fast-v0", config=CROWDED)
    print(f"| {SHOWN} others | frames | state ms | observe ms | scene of it ms | of reading the state |")
    print("| :-- | --: | --: | --: | --: | --: |")
    for name, each in (("exact", env), ("metric-0.5", SensorNoise(env, SENSORS["metric-0.5"]))):
        (read, observed, made), frames = measure(each, episodes)
        print(f"| {name} | {frames} | {read:.3f} | {observed:.3f} | {made:.3f} | {made / read:.1f} |")


if __name__ == "__main__":
    main()
