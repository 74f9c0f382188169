"""Whether a scene is lost at the reset: for how many frames the best of all sequences of three meta-actions goes on
without a crash, each driven in the exact future.

python benchmarks/lost_at_reset.py two-way-v0 80200611 80205509 80208095 80209751 80209844
"""

from __future__ import annotations

import argparse
from itertools import product
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np

from dynamics.road_networks.simulation.frame_kernels import ego_of
from dynamics.road_networks.simulation.simulator import NetworkSimulator

LENGTH = 3


def longest(env: gym.Env[Any, Any]) -> int:
    """Frames before a crash, of the best sequence; all of them where there is none."""
    simulator, best = NetworkSimulator(env), 0
    for actions in product(range(len(simulator.rules.labels)), repeat=LENGTH):
        simulator.load(env)
        crashed = np.concatenate([simulator.step(a)[:, ego_of(simulator.worlds.g[0]), 6].copy() for a in actions])
        best = max(best, int(crashed.argmax()) if crashed.any() else len(crashed))
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("env_id")
    parser.add_argument("seeds", nargs="+", type=int)
    asked = parser.parse_args()
    env = gym.make(asked.env_id)
    print("| seed | nearest in its lane m | slower by m/s | frames of the best |\n| --: | --: | --: | --: |")
    for seed in asked.seeds:
        env.reset(seed=seed)
        base: Any = env.unwrapped
        ego = base.vehicle
        others = (v for v in base.road.vehicles if v is not ego and v.lane_index == ego.lane_index)
        nearest = min(others, key=lambda v: abs(v.position[0] - ego.position[0]))
        gap, slower = nearest.position[0] - ego.position[0], ego.speed - nearest.speed
        print(f"| {seed} | {gap:.1f} | {slower:.1f} | {longest(env)} |")


if __name__ == "__main__":
    main()
