"""Bird's-eye frames of the compiled simulators, beside a decision with them and highway-env's own picture.

    python benchmarks/frames.py [--rounds 200]

Frames of 64 environments are drawn at a time, 5 x 64 x 64. The rival is highway-env's `GrayscaleObservation` of 128 x
64 pixels, one channel, which draws with pygame.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from time import perf_counter
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.table import Table

from dynamics.highway_simulator.simulator import Simulator
from dynamics.road_networks.episodes.simulator import RoadSimulator
from dynamics.traffic.crossing import make
from dynamics.world_model import BirdsEye, FrameView

ENVS = 64
ROADS = ("highway-fast-v0", "highway-v0", "merge-v0", "roundabout-v0", "intersection-v0")
IDLE = 1


def microseconds(call: Callable[[], Any], rounds: int, each: int) -> float:
    """Median time of a call, divided by `each` [µs]."""
    call()
    times = []
    for _ in range(rounds):
        start = perf_counter()
        call()
        times.append(perf_counter() - start)
    return float(np.median(times)) * 1e6 / each


def rival(env_id: str, rounds: int) -> float:
    """Time of highway-env's own picture [µs]."""
    picture = {"type": "GrayscaleObservation", "observation_shape": (128, 64), "stack_size": 1, "scaling": 1.0}
    env: Any = make(env_id, {"observation": {**picture, "weights": [0.3, 0.6, 0.1]}}).unwrapped
    env.reset(seed=0)
    return microseconds(env.observation_type.observe, rounds, 1)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rounds", type=int, default=200)
    rounds = parser.parse_args().rounds
    shown = Table("road", "frame µs", "decision µs", "frame / decision", "highway-env's picture µs", "ratio")
    for env_id in ROADS:
        simulator: Any = (Simulator if env_id.startswith("highway") else RoadSimulator)(env_id, ENVS)
        simulator.reset(range(ENVS))
        env: gym.Env[Any, Any] = make(env_id, {})
        env.reset(seed=0)
        network: Any = env.unwrapped.road.network  # type: ignore[attr-defined]
        eye, frames = BirdsEye(), np.zeros((ENVS, *FrameView().shape), np.uint8)
        frame = microseconds(lambda s=simulator, e=eye, n=network, f=frames: e.frames(s, n, f), rounds, ENVS)
        actions = np.full(ENVS, IDLE)
        decision = microseconds(lambda s=simulator, a=actions: s.step(a, again=True), max(rounds // 10, 5), ENVS)
        own = rival(env_id, max(rounds // 10, 5))
        row = frame, decision, frame / decision, own, own / frame
        shown.add_row(env_id, *(f"{value:.3g}" for value in row))
    Console().print(shown)


if __name__ == "__main__":
    main()
