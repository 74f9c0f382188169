"""An environment on a road network twice, highway-env's own and compiled, driven side by side."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest

from dynamics.highway_simulator.layout import CONTINUOUS, IMPACT_X, IMPACT_Y, IMPACTED, KIND, TARGET
from dynamics.highway_simulator.random import from_generator
from dynamics.road_networks.episodes.info import info_of
from dynamics.road_networks.episodes.simulator import RoadSimulator
from dynamics.road_networks.geometry.layout import FRAMES, ROUTE, ROUTE_END
from dynamics.road_networks.simulation.frame_kernels import new_worlds
from dynamics.road_networks.simulation.live import load

__all__ = ["RoadPair"]


class RoadPair:
    """Both, and what they have in common after each decision."""

    def __init__(self, env_id, config=None):
        self.name = env_id
        self.env = gym.make(env_id, config=config)
        self.simulator = RoadSimulator(env_id, 1, config)
        if not self.simulator.exact:
            pytest.skip("this machine's numpy adds in a way of its own")
        scenario = self.simulator.scenario
        self._read = new_worlds(1, scenario.bodies, scenario.entries, 0)

    def reset(self, seed):
        self.name = f"{self.env.spec.id} seed {seed}"
        self.decisions = 0
        seen, _ = self.env.reset(seed=seed)
        np.testing.assert_array_equal(self.simulator.reset([seed])[0], seen, err_msg=self.name)
        self.compare()

    def step(self, action):
        """One decision of both; whether the episode is over."""
        self.decisions += 1
        seen, reward, terminated, truncated, info = self.env.step(action)
        others = self.simulator.step([action])
        name = f"{self.name} decision {self.decisions}"
        for one, other in zip((seen, reward, bool(terminated), bool(truncated)), others, strict=True):
            np.testing.assert_array_equal(other[0], one, err_msg=name)
        assert others[0].dtype == seen.dtype
        np.testing.assert_equal(info_of(self.simulator, 0, action), info, err_msg=name)
        self.compare()
        return bool(terminated or truncated)

    def compare(self):
        """Every number of every body, every route, and the generator."""
        scenario, mine, read = self.simulator.scenario, self.simulator.episodes.worlds, self._read
        load(self.env, scenario.rules.drive, scenario.lanes, read, 0)
        np.testing.assert_array_equal(mine.counts, read.counts, err_msg=self.name)
        n = mine.counts[0, 1]
        regulated = hasattr(self.env.unwrapped.road, "steps")
        for name, arrays in (("f", (mine.f, read.f)), ("g", (mine.g, read.g)), ("p", (mine.p, read.p))):
            one, other = (array[0, :, :n].copy() for array in arrays)
            for array in (one, other):
                if name == "f":
                    array[IMPACT_X : IMPACT_Y + 1, mine.g[0, IMPACTED, :n] == 0] = 0.0
                if name == "g":
                    array[[ROUTE, ROUTE_END]] = 0
                    array[TARGET, array[KIND] == CONTINUOUS] = 0
                    array[FRAMES] *= regulated
            np.testing.assert_array_equal(one, other, err_msg=f"{self.name} {name} after {self.decisions}")
        for i in range(n):
            assert self._route(mine, i) == self._route(read, i), f"{self.name} body {i}"
        generator = from_generator(self.env.unwrapped.np_random)
        np.testing.assert_array_equal(self.simulator.episodes.rows[0], generator, err_msg=self.name)

    @staticmethod
    def _route(worlds, i):
        """What is left of a vehicle's route; None without one."""
        first, last = worlds.g[0, ROUTE, i], worlds.g[0, ROUTE_END, i]
        return None if last < 0 else worlds.routes[0, i, first:last].tolist()

    def drive(self, seeds, decisions=60):
        """Episodes of random actions; how many came to an end."""
        ends = 0
        for seed in seeds:
            self.reset(seed)
            self.env.action_space.seed(seed)
            for _ in range(decisions):
                if self.step(self.env.action_space.sample()):
                    ends += 1
                    break
        return ends
