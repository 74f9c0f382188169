"""In how many episodes of intersection-v0 some sequence of actions arrives in time, as far as a beam search finds it in
the compiled traffic: what arrival can be asked of a driver there. Who comes later is in none of its futures.

    python benchmarks/intersection_bound.py [--episodes 200] [--seed 700000]
"""

from __future__ import annotations

import argparse
import warnings
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np

from dynamics.highway_simulator.layout import CRASHED, LANE, SPEED
from dynamics.road_networks.geometry.layout import ALONG
from dynamics.road_networks.geometry.network import index_of
from dynamics.road_networks.simulation.frame_kernels import ego_of
from dynamics.road_networks.simulation.simulator import NetworkSimulator

BEAM, EXIT = 24, 25.0
"""Futures that are followed; how far along its exit road the ego has arrived [m]."""
ROADS = {"o": 0.0, "ir": 200.0, "il": 400.0}
"""What progress is counted from on each kind of road [m]."""


def arrives(env: Any) -> int:
    """After how many decisions the ego can have arrived; 0 for not at all."""
    actions = env.action_space.n
    simulator = NetworkSimulator(env, 1 + BEAM * (1 + actions))
    names = {number: key for key, number in index_of(env.road.network).items()}
    parents = [0]
    for decision in range(1, round(env.config["duration"] * env.config["policy_frequency"]) + 1):
        reached: dict[tuple[int, int], int] = {}
        for k, (parent, action) in enumerate((p, a) for p in parents for a in range(actions)):
            child = 1 + BEAM + k
            for each in simulator.worlds:
                each[child] = each[parent]
            simulator.step(action, child)
            f, g = simulator.worlds.f[child], simulator.worlds.g[child]
            ego = ego_of(g)
            if g[CRASHED, ego]:
                continue
            kind = names[int(g[LANE, ego])][0][:-1]
            if kind == "il" and f[ALONG, ego] >= EXIT:
                return decision
            reached.setdefault((round(ROADS[kind] + f[ALONG, ego]), round(f[SPEED, ego])), child)
        # Spread over all that was reached: who is ahead now may have to wait for longest.
        places = sorted(reached, reverse=True)
        kept = [places[i] for i in np.unique(np.linspace(0, len(places) - 1, BEAM).astype(int))] if places else []
        for slot, place in enumerate(kept):
            for each in simulator.worlds:
                each[1 + slot] = each[reached[place]]
        parents = list(range(1, 1 + len(kept)))
    return 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--seed", type=int, default=700_000)
    asked = parser.parse_args()
    warnings.filterwarnings("ignore", category=DeprecationWarning)
    env: Any = gym.make("intersection-v0").unwrapped
    times = []
    for seed in range(asked.seed, asked.seed + asked.episodes):
        env.reset(seed=seed)
        times.append(arrives(env))
    found = [each for each in times if each]
    print(f"{len(found)} of {len(times)} arrive, after {np.mean(found):.2f} s on the average")


if __name__ == "__main__":
    main()
