"""Crashes and offences at few simulation frames a second, where the shield refuses to verify.

Always FASTER, or full throttle with the wheel straight, decisions at 1 Hz, at most 60 of them:

    python benchmarks/low_frequencies.py --hz 1 2 3 4 5 --episodes 20 --seed 912000
"""

from __future__ import annotations

import argparse
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np

from shield import ShieldConfig, ShieldedEnv
from shield import supported_environments as refusals

INPUTS: dict[str, Any] = {"action": {"type": "ContinuousAction"}}
CELLS: dict[str, tuple[str, ShieldConfig, dict[str, Any]]] = {
    "highway-fast-v0, worst case": ("highway-fast-v0", ShieldConfig(), {}),
    "highway-fast-v0, throttle, worst case": (
        "highway-fast-v0",
        ShieldConfig(),
        {"action": {"type": "ContinuousAction"}},
    ),
    "merge-v1, worst case": ("merge-v1", ShieldConfig.for_roads(), {}),
    "highway-fast-v0, simulated": ("highway-fast-v0", ShieldConfig.simulated_traffic(), {}),
    "merge-v1, simulated": ("merge-v1", ShieldConfig.simulated_traffic(), {}),
    "roundabout-v1, simulated": ("roundabout-v1", ShieldConfig.simulated_traffic(), {}),
}


def measure(cell: str, frequency: int, episodes: int, seed: int) -> tuple[int, int]:
    """How many episodes crashed, and in how many the traffic broke an assumption."""
    env_id, settings, config = CELLS[cell]
    rates = {"simulation_frequency": frequency, "policy_frequency": 1}
    env = ShieldedEnv(gym.make(env_id, config={**config, **rates}), settings)
    action: Any = np.array([1.0, 0.0], np.float32) if config else 3
    crashed = offended = 0
    for k in range(seed, seed + episodes):
        env.reset(seed=k)
        violations = 0
        for _ in range(60):
            *_, terminated, truncated, info = env.step(action)
            violations += info["shield"]["violations"]
            if terminated or truncated:
                break
        crashed += bool(env.unwrapped.vehicle.crashed)
        offended += violations > 0
    return crashed, offended


def main() -> None:
    """Print a table: crashes / episodes with offences."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hz", nargs="*", type=int, default=[1, 2, 3, 4, 5])
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=912_000)
    parser.add_argument("--cells", nargs="*", default=list(CELLS))
    asked = parser.parse_args()
    refusals.LOWEST = refusals.LOWEST_SIMULATED = 0
    print("| of", asked.episodes, "episodes: crashes / with offences |", " | ".join(f"{hz} Hz" for hz in asked.hz), "|")
    print("| :-- |" + " --: |" * len(asked.hz))
    for cell in asked.cells:
        found = [measure(cell, hz, asked.episodes, asked.seed) for hz in asked.hz]
        print(f"| {cell} |", " | ".join(f"{crashed} / {offended}" for crashed, offended in found), "|", flush=True)


if __name__ == "__main__":
    main()
