"""What `decision.explain()` takes when it is asked for, and what being able to answer costs a step otherwise, in
processor time.

python -m benchmarks.explain [NAME ...]

Each setting is measured in a process of its own, so "first" includes what the first explanation reads
from the disk; the others are of the steps after that. Kernels have to be compiled already (`shield warm`).
"""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from time import process_time
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np

from shield import ShieldConfig, ShieldedEnv
from shield.filters.network import NetworkFilter
from shield.filters.simulated.predicted_scene import PredictedScene
from shield.pipelines.decide import DecisionCore

INPUTS = {"action": {"type": "ContinuousAction"}}
SETTINGS: dict[str, tuple[str, dict[str, Any], ShieldConfig]] = {
    "highway, meta-actions": ("highway-fast-v0", {}, ShieldConfig()),
    "highway, inputs": ("highway-fast-v0", INPUTS, ShieldConfig()),
    "highway, simulated": ("highway-fast-v0", {}, ShieldConfig.simulated_traffic()),
    "highway, simulated inputs": ("highway-fast-v0", INPUTS, ShieldConfig.simulated_traffic()),
    "roundabout, worst case": ("roundabout-v1", {}, ShieldConfig.for_roads()),
    "roundabout, simulated": ("roundabout-v1", {}, ShieldConfig.simulated_traffic()),
    "intersection, simulated": ("intersection-v2", {}, ShieldConfig.simulated_traffic()),
    "intersection, simulated inputs": ("intersection-v1", {}, ShieldConfig.simulated_traffic()),
    "parking": ("parking-v0", {"vehicles_count": 10, "duration": 20}, ShieldConfig()),
}
STEPS, ASKED = 60, 400
"""Steps whose cost is compared, and steps whose overrides are explained."""


def drive(name: str, ask: bool, steps: int = STEPS) -> tuple[list[float], list[float]]:
    """Processor seconds of each step of the shielded environment, and of each explanation, over so many steps."""
    env_id, settings, config = SETTINGS[name]
    env = ShieldedEnv(gym.make(env_id, config=settings), config)
    rng, seed, done = np.random.default_rng(0), 0, True
    stepping: list[float] = []
    asked: list[float] = []
    space: Any = env.action_space
    for _ in range(steps):
        if done:
            env.reset(seed=seed)
            seed += 1
        eager = rng.random() < 0.7
        if isinstance(space, gym.spaces.Discrete):
            action: Any = int(space.n) - 2 if eager else int(rng.integers(space.n))
        else:
            action = np.clip(rng.normal(0.7, 0.5, space.shape), -1, 1).astype(np.float32)
        start = process_time()
        *_, terminated, truncated, _ = env.step(action)
        stepping.append(process_time() - start)
        record, done = env.last_decision, terminated or truncated
        if ask and record is not None and record.overridden:
            start = process_time()
            record.explain()
            asked.append(process_time() - start)
    return stepping, asked


def without_sources() -> Any:
    """Have nothing kept for explanations, and return what undoes it."""
    kept = DecisionCore.__init__, PredictedScene.kept, NetworkFilter._kept

    def core(self: Any, procedure: Any, explain: Any = None) -> None:
        kept[0](self, procedure, None)

    DecisionCore.__init__, PredictedScene.kept, NetworkFilter._kept = core, lambda *_, **__: None, lambda *_: None  # type: ignore

    def undo() -> None:
        DecisionCore.__init__, PredictedScene.kept, NetworkFilter._kept = kept  # type: ignore[method-assign]

    return undo


def row(name: str) -> str:
    """What is measured of a setting, as a row of the table."""
    first, *asked = drive(name, True, ASKED)[1] or [np.nan]
    steps: dict[bool, list[float]] = {True: [], False: []}
    for _ in range(3):
        steps[True] += drive(name, False)[0]
        undo = without_sources()
        steps[False] += drive(name, False)[0]
        undo()
    p50, p99, most = np.percentile(1e3 * np.array(asked), [50, 99, 100]) if asked else (np.nan,) * 3
    kept, bare = (1e3 * np.median(steps[each]) for each in (True, False))
    times = f"{1e3 * first:.1f} | {p50:.1f} | {p99:.1f} | {most:.1f} | {kept:.2f} | {bare:.2f}"
    return f"| {name} | {len(asked)} | {times} |"


def main() -> None:
    """Print a row for each setting."""
    print("| setting | explanations | ms first | p50 | p99 | most | ms a step, kept | not kept |")
    print("|:--|--:|--:|--:|--:|--:|--:|--:|")
    for name in sys.argv[1:] or SETTINGS:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            print(pool.submit(row, name).result(), flush=True)


if __name__ == "__main__":
    main()
