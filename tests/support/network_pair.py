"""A live environment on a network of roads, and its compiled copy."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
from simulator_pair import same_numbers

from dynamics.networks.layout import ROUTE, ROUTE_END, YIELDS
from dynamics.networks.network import index_of
from dynamics.networks.simulator import NetworkSimulator
from dynamics.simulator.layout import KIND, LANE, OBSTACLE, TARGET, TARGET_SPEED, TIMER

__all__ = ["Pair"]


class Pair:
    """A live environment, and its compiled copy."""

    def __init__(self, env_id, seed, config=None):
        self.env = gym.make(env_id, config=dict(config or {})).unwrapped
        self.env.reset(seed=seed)
        self.name = f"{env_id} seed {seed}"
        self.start()

    def start(self):
        self.simulator = NetworkSimulator(self.env)
        self.bodies = list(self.env.road.vehicles)
        self.numbers = index_of(self.env.road.network)

    def step(self, action):
        """A decision of both, compared; whether the episode is over."""
        _, _, terminated, truncated, _ = self.env.step(action)
        rows = self.simulator.step(action)[-1]
        self.compare(rows)
        return terminated or truncated

    def compare(self, rows):
        """Everybody who is still there."""
        road, f, g = self.env.road, self.simulator.worlds.f[0], self.simulator.worlds.g[0]
        there = [v in road.vehicles for v in self.bodies] + [True] * len(road.objects)
        assert [kind == OBSTACLE for kind in g[KIND, : len(self.bodies)]] == [
            not each for each in there[: len(self.bodies)]
        ]
        rows, f, g = rows[there], f[:, there], g[:, there]
        bodies, m = [*road.vehicles, *road.objects], len(road.vehicles)
        real = np.array([[*v.position, v.heading, v.speed] for v in bodies], float)
        exact = self.simulator.exact
        assert same_numbers(real, rows[:, :4], exact), self.name
        assert [v.crashed for v in bodies] == (rows[:, 6] > 0).tolist(), self.name
        assert [self.numbers[self.key(v.lane_index)] for v in road.vehicles] == g[LANE, :m].tolist(), self.name
        assert [self.numbers[self.key(v.target_lane_index)] for v in road.vehicles] == g[TARGET, :m].tolist(), self.name
        assert same_numbers([float(v.target_speed) for v in road.vehicles], f[TARGET_SPEED, :m], exact), self.name
        assert same_numbers([float(getattr(v, "timer", 0.0)) for v in road.vehicles], f[TIMER, :m], exact), self.name
        assert [getattr(v, "is_yielding", False) for v in road.vehicles] == g[YIELDS, :m].tolist(), self.name
        assert [-1 if v.route is None else len(v.route) for v in road.vehicles] == (g[ROUTE_END] - g[ROUTE])[
            :m
        ].tolist()

    @staticmethod
    def key(index):
        return index[0], index[1], int(index[2])
