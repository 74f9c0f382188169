"""How often somebody unseen is nearer to the ego, or slower ahead of it, than a shield that reads observations takes it
to be: episodes of highway-fast-v0 with highway-env's own observation, always FASTER behind the shield.

    python benchmarks/unseen.py [--episodes 40] [--seed 5000]
"""

from __future__ import annotations

import argparse
from collections import Counter
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np

from shield import ShieldedEnv, Unseen
from shield.perception.perceiving import ObservationPerception

NEAR = 60.0
"""Who is further away is not counted [m]."""


def count(perception: ObservationPerception, base: Any, unseen: Unseen, found: Counter[str]) -> None:
    """Compare who is there with who may be there, as far as it is not seen."""
    ego, (far, _) = base.vehicle, perception.edges
    states, place = perception.tracks.mean, perception.ego
    for vehicle in base.road.vehicles:
        ahead_by = vehicle.position[0] - ego.position[0]
        away = np.abs(states[:, 0] - place[0] - ahead_by) + np.abs(states[:, 1] - vehicle.position[1])
        if vehicle is ego or abs(ahead_by) > NEAR or away.min(initial=np.inf) < 0.5:
            continue
        if ahead_by > 0:
            found["ahead"] += 1
            found["ahead, nearer or slower"] += ahead_by < far - 0.01 or vehicle.speed < unseen.slowest - 0.01
            continue
        found["behind"] += 1
        for name, across in (("in its lane", 3.0), ("in it or beside it", 7.0)):
            pool = perception.behind.passed
            nearest = pool[np.abs(pool[:, 1] - vehicle.position[1]) < across, 0].max(
                initial=perception.behind.nearest_unseen
            )
            found[f"behind, nearer than anybody {name}"] += nearest < ahead_by - 0.01


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=40)
    parser.add_argument("--seed", type=int, default=5000)
    asked = parser.parse_args()
    found: Counter[str] = Counter()
    env = ShieldedEnv(gym.make("highway-fast-v0"), perception="observation")
    reader: Any = env.filter.reader  # type: ignore[union-attr]
    for seed in range(asked.seed, asked.seed + asked.episodes):
        env.reset(seed=seed)
        over = False
        while not over:
            *_, terminated, truncated, _ = env.step(3)
            over = terminated or truncated
            reader.read()
            count(reader.perception, env.unwrapped, Unseen(), found)
    for name, number in sorted(found.items()):
        print(f"{name}: {number}")


if __name__ == "__main__":
    main()
