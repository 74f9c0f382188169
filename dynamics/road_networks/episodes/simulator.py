"""`RoadSimulator`: highway-env's environments on road networks, compiled, many episodes at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from dynamics.errors import ConfigError, SceneError
from dynamics.highway_simulator.arithmetic import Sums, sums_of_numpy
from dynamics.highway_simulator.arrays import Machine
from dynamics.highway_simulator.batch_arguments import checked_resets, checked_steps, kernel_actions
from dynamics.highway_simulator.loops import addresses
from dynamics.highway_simulator.random import WORDS, from_generator
from dynamics.road_networks.episodes.scenario import RoadScenario, road_scenario_of
from dynamics.road_networks.episodes.step_kernels import Episodes, EpisodeWork, RoadStepResults, reset_all, step_all
from dynamics.road_networks.geometry.layout import COUNT
from dynamics.road_networks.simulation.frame_kernels import (
    NetworkRules,
    NetworkWork,
    NetworkWorlds,
    new_work,
    new_worlds,
)
from dynamics.road_networks.simulation.live import load
from dynamics.slices import Slices
from dynamics.state import FloatArray
from dynamics.traffic.crossing import with_own_traffic

__all__ = ["RoadSimulator"]


class RoadSimulator:
    """`num_envs` copies of an environment on a road network, stepped together, equal to highway-env to the last bit.

    Parameters
    ----------
    env_id : merge, merge-generic, roundabout, roundabout-generic, exit, two-way, u-turn or intersection, any version.
    num_envs : number of copies.
    config : changes of the default configuration.
    threads : number of threads that share the environments of a step.

    Raises
    ------
    ConfigError
        If the simulator does not support the environment's configuration.
    PlatformError
        If numpy's own loops are not found where expected, or another version of highway-env is installed.

    Attributes
    ----------
    scenario : the environment as arrays.
    episodes : the state of all copies (see `step_kernels.Episodes`).
    seen : results of the last call (see `step_kernels.RoadsSeen`). flat : the same, with observations as rows of
        features.
    exact : whether the way in which this machine's numpy computes sums of products is known.

    Notes
    -----
    The constants of the traffic's class are read when the simulator is built. highway-env's intersections change them,
    for all environments of the process with traffic of the same class.

    Examples
    --------
    >>> simulator = RoadSimulator("merge-v0", 2)
    >>> observations = simulator.reset([0, 1])
    >>> observations, reward, terminated, truncated = simulator.step([3, 1])
    >>> observations.shape, reward.shape
    ((2, 5, 5), (2,))
    """

    def __init__(
        self, env_id: str, num_envs: int = 1, config: Mapping[str, Any] | None = None, threads: int = 1
    ) -> None:
        if num_envs < 1 or threads < 1:
            raise ConfigError(f"num_envs and threads must be at least 1, not {num_envs} and {threads}")
        self.scenario: RoadScenario = road_scenario_of(env_id, config)
        self.num_envs, scenario = num_envs, self.scenario
        sums, products = sums_of_numpy()
        self.exact = Sums.OTHER not in (sums, products)
        self.machine = Machine(sums, products, addresses())
        words, decisions = np.zeros((num_envs, WORDS), np.uint64), np.zeros(num_envs, np.int64)
        self.episodes = Episodes(self.new_worlds(num_envs), words, decisions)
        self._slices = Slices(num_envs, threads)
        self._works = [self.episode_work() for _ in self._slices.bounds]
        rows, features = scenario.shape
        self.flat = RoadStepResults(
            np.zeros((num_envs, rows, features), np.float32),
            np.zeros((num_envs, rows, features), np.float32),
            np.zeros(num_envs),
            np.zeros(num_envs, np.bool_),
            np.zeros(num_envs, np.bool_),
            np.zeros((num_envs, 5)),
            np.zeros(num_envs),
            np.zeros(num_envs, np.bool_),
            np.zeros(num_envs, np.bool_),
        )
        shape = (num_envs, *scenario.observation_space.shape)
        flat = self.flat
        self.seen = flat._replace(observations=flat.observations.reshape(shape), terminal=flat.terminal.reshape(shape))
        entropy = np.random.SeedSequence().generate_state(num_envs, np.uint64) >> np.uint64(1)
        self.reset(entropy.astype(np.int64))

    @property
    def rules(self) -> NetworkRules:
        """The constants of the motion, for the kernels."""
        return self.scenario.rules.drive

    def new_worlds(self, count: int) -> NetworkWorlds:
        """Buffers for `count` further scenes."""
        return new_worlds(count, self.scenario.bodies, self.scenario.entries, 0)

    def new_work(self) -> NetworkWork:
        """Buffers for the frames of one further thread."""
        return new_work(self.scenario.bodies)

    def episode_work(self) -> EpisodeWork:
        """Buffers for the episodes of one further thread."""
        scenario = self.scenario
        network, bodies = scenario.rules.drive.network, scenario.bodies
        lanes = int(network.ids[:, COUNT].max())
        return EpisodeWork(
            new_work(bodies),
            np.zeros(bodies, np.int64),
            np.zeros(bodies),
            np.zeros(scenario.shape),
            np.zeros((3 * network.outs.shape[1] + 1, 3), np.int64),
            np.zeros((lanes, max(1, scenario.rules.sight.steps))),
        )

    def reset(
        self, seeds: Sequence[int] | NDArray[Any] | None = None, which: Sequence[int] | None = None
    ) -> NDArray[np.float32]:
        """Start new episodes.

        Parameters
        ----------
        seeds : one for each environment, as of `env.reset(seed=...)`; with None, the present generators continue.
        which : the environments to reset; all by default.

        Returns
        -------
        The observations of all environments, (e, *shape) float32. The next call overwrites the array.
        """
        chosen, numbers = checked_resets(self.num_envs, seeds, which)
        self.flat.full[chosen] = False
        reset_all(self.machine, self.episodes, self.scenario.rules, self._works[0], self.flat, chosen, numbers)
        return self.seen.observations

    def step(
        self, actions: Any, again: bool = False, which: Sequence[int] | NDArray[Any] | None = None
    ) -> tuple[NDArray[np.float32], FloatArray, NDArray[np.bool_], NDArray[np.bool_]]:
        """One decision in each environment.

        Parameters
        ----------
        actions : (e,) meta-actions, or (e, size) throttle and steering.
        again : whether an episode that ends is followed by a new one at once. `seen.terminal` then holds its last
            observation.
        which : the environments to step, in increasing order; all by default. The entries of the others stay unchanged.

        Returns
        -------
        Observations (e, *shape), rewards (e,), terminated (e,) and truncated (e,). The next call overwrites the arrays.

        Raises
        ------
        ActionError
            If there is not one action for each environment, or one is not in the action space.
        ConfigError
            If `which` is not in increasing order, or an environment does not exist.
        SceneError
            If more vehicles entered an intersection than there is room for.
        """
        given, seen = self._given(actions), self.seen

        def part(k: int, first: int, last: int) -> None:
            rules, work = self.scenario.rules, self._works[k]
            step_all(self.machine, self.episodes, rules, work, self.flat, given, (first, last, again))

        self._slices.run(part, checked_steps(self.num_envs, which))
        self.check_capacity()
        return seen.observations, seen.reward, seen.terminated, seen.truncated

    def check_capacity(self) -> None:
        """Check that all vehicles that entered an intersection had room.

        Raises
        ------
        SceneError
            If one had none.
        """
        if self.seen.full.any():
            raise SceneError(f"{self.scenario.env_id} has room for {self.scenario.bodies} vehicles, and more came")

    def load(self, env: gym.Env[Any, Any], e: int = 0) -> None:
        """Copy a live environment of the same configuration, between two decisions, into copy `e`.

        Raises
        ------
        ConfigError
            If there is no copy `e`.
        SceneError
            If the configuration differs, there is no room for its bodies or routes, or a vehicle has an unknown driving
            model.
        """
        if not 0 <= e < self.num_envs:
            raise ConfigError(f"there are environments 0 to {self.num_envs - 1}, not {e}")
        base, scenario = cast(Any, env.unwrapped), self.scenario
        if with_own_traffic(scenario.env_id, base.config) != scenario.config:
            raise SceneError("the environment has another configuration than the simulator")
        load(env, scenario.rules.drive, scenario.lanes, self.episodes.worlds, e)
        self.episodes.rows[e] = from_generator(base.np_random)
        self.episodes.decisions[e] = base.steps // scenario.rules.drive.numbers[0]

    def _given(self, actions: Any) -> FloatArray:
        """Actions in the form of the kernels, (e, 2)."""
        return kernel_actions(actions, self.num_envs, len(self.scenario.rules.drive.labels), self.scenario.inputs)
