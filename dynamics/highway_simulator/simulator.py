"""`Simulator`: highway-env's highway, compiled, many episodes at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from dynamics.errors import ConfigError
from dynamics.highway_simulator.arithmetic import Sums, sums_of_numpy
from dynamics.highway_simulator.arrays import Machine, Rules, Simulation, StepResults, Work, Worlds
from dynamics.highway_simulator.batch_arguments import checked_resets, checked_steps, kernel_actions
from dynamics.highway_simulator.layout import LINEAR, F, G, P
from dynamics.highway_simulator.live import bodies_of, load, store
from dynamics.highway_simulator.loops import addresses
from dynamics.highway_simulator.random import REPLAY_START, WORDS
from dynamics.highway_simulator.scenario import Scenario, scenario_of, scenario_of_live
from dynamics.highway_simulator.step_kernels import begin, finish, frame, observe, reset_all, step_all, write_rows
from dynamics.slices import Slices
from dynamics.state import FloatArray

__all__ = ["Simulator"]


class Simulator:
    """`num_envs` copies of `highway-v0` or `highway-fast-v0`, stepped together, equal to highway-env to the last bit.

    Parameters
    ----------
    env_id : the environment.
    num_envs : number of copies.
    config : changes of the default configuration.
    threads : number of threads that share the environments of a step. A further thread pays from some 64 environments
        on.
    replay_draws : whether `reset_to` is available: scenes from chosen random numbers.

    Raises
    ------
    ConfigError
        If the simulator does not support the environment's configuration.
    PlatformError
        If numpy's own loops are not found where expected.

    Attributes
    ----------
    scenario : the environment as arrays.
    worlds : the state of all copies, arrays that may be read and written (see `arrays.Worlds`, `layout`).
    seen : results of the last call (see `step_kernels.Seen`). flat : the same, with the cells of a grid in one axis.
    exact : whether the way in which this machine's numpy computes sums of products is known. If not, states initially
        agree to some 1e-12.

    Examples
    --------
    >>> simulator = Simulator("highway-fast-v0", 2)
    >>> observations = simulator.reset([0, 1])
    >>> observations, reward, terminated, truncated = simulator.step([3, 1])
    >>> observations.shape, reward.shape
    ((2, 5, 5), (2,))
    """

    def __init__(
        self,
        env_id: str,
        num_envs: int = 1,
        config: Mapping[str, Any] | None = None,
        threads: int = 1,
        replay_draws: bool = False,
    ) -> None:
        self._network: Any = None
        self._build(scenario_of(env_id, config), num_envs, threads, replay_draws)
        entropy = np.random.SeedSequence().generate_state(num_envs, np.uint64) >> np.uint64(1)
        self.reset(entropy.astype(np.int64))

    @classmethod
    def of(cls, env: gym.Env[Any, Any], num_envs: int = 1, observes: bool = True) -> Simulator:
        """Copies of a live environment in its present state, between two decisions, obstacles included.

        Parameters
        ----------
        observes : False if only states are needed; then the environment may have any observation.

        Raises
        ------
        ConfigError
            If the simulator does not support the environment's configuration.
        SceneError
            If it does not support the scene: another road, unknown objects, or an unknown driving model.
        """
        scenario = scenario_of_live(cast(Any, env.unwrapped), observes)
        vehicles, obstacles = bodies_of(env)
        rules = scenario.rules
        numbers = (rules.numbers[0], len(vehicles), *rules.numbers[2:])
        bodies = len(vehicles) + len(obstacles)
        simulator = cls.__new__(cls)
        simulator._network = cast(Any, env.unwrapped).road.network
        simulator._build(replace(scenario, rules=rules._replace(numbers=numbers), bodies=bodies), num_envs)
        for e in range(num_envs):
            simulator.load(env, e)
        return simulator

    def _check_configured(self) -> None:
        """Check that a reset would create as many bodies as there are.

        Raises
        ------
        ConfigError
            If not.
        """
        vehicles = 1 + int(self.scenario.config["vehicles_count"])
        if not self.scenario.bodies == self.scenario.rules.numbers[1] == vehicles:
            raise ConfigError("a reset makes the configured vehicles; the live scene has others: load() it again")

    def _check_copy(self, e: int) -> None:
        """Check that there is a copy `e`.

        Raises
        ------
        ConfigError
            If not.
        """
        if not 0 <= e < self.num_envs:
            raise ConfigError(f"there are environments 0 to {self.num_envs - 1}, not {e}")

    def fits(self, env: gym.Env[Any, Any]) -> bool:
        """Whether `load` accepts a live environment: the road from which this simulator was built (`of`), as many
        bodies, and the same frequencies."""
        base = cast(Any, env.unwrapped)
        road, config, rules = base.road, base.config, self.scenario.rules
        if road is None or road.network is not self._network:
            return False
        times = 1 / config["simulation_frequency"], 1 / config["policy_frequency"]
        bodies = rules.numbers[1], self.scenario.bodies - rules.numbers[1]
        return times == rules.times[:2] and bodies == (len(road.vehicles), len(road.objects))

    def load(self, env: gym.Env[Any, Any], e: int = 0) -> None:
        """Copy a live environment, between two decisions, into copy `e`; see `live.load`.

        Raises
        ------
        ConfigError
            If there is no copy `e`.
        """
        self._check_copy(e)
        load(env, self.scenario, self.worlds, e)

    def store(self, env: gym.Env[Any, Any], e: int = 0) -> None:
        """Copy copy `e` into a live environment with the same bodies; see `live.store`.

        Raises
        ------
        ConfigError
            If there is no copy `e`.
        """
        self._check_copy(e)
        store(env, self.scenario, self.worlds, e)

    def _build(self, scenario: Scenario, num_envs: int, threads: int = 1, replay_draws: bool = False) -> None:
        """Set up the arrays and buffers for a scenario."""
        if num_envs < 1 or threads < 1:
            raise ConfigError(f"num_envs and threads must be at least 1, not {num_envs} and {threads}")
        self.scenario = scenario
        self.num_envs, e = num_envs, num_envs
        sums, products = sums_of_numpy()
        self.exact = Sums.OTHER not in (sums, products)
        self.machine = Machine(sums, products, addresses())
        self.worlds = self.new_worlds(e, REPLAY_START + self.draws if replay_draws else WORDS)
        shape = scenario.observation_space.shape
        rows, features = shape[0], int(np.prod(shape[1:]))
        self._slices = Slices(e, threads)
        self._works = [self.new_work() for _ in self._slices.bounds]
        flat = StepResults(
            np.zeros((e, rows, features), np.float32),
            np.zeros((e, rows, features), np.float32),
            np.zeros(e),
            np.zeros(e, np.bool_),
            np.zeros(e, np.bool_),
            np.zeros((e, 4)),
            np.zeros(e),
        )
        self.flat = flat
        shown = flat.observations.reshape(e, *shape), flat.terminal.reshape(e, *shape)
        self.seen = flat._replace(observations=shown[0], terminal=shown[1])

    @property
    def rules(self) -> Rules:
        """The constants of all copies, for the kernels."""
        return self.scenario.rules

    @property
    def draws(self) -> int:
        """Number of random numbers of an initial scene: lane and position of the ego, and lane, speed, position and
        parameters of each vehicle."""
        _, vehicles, first_lane, _, _, kind = self.scenario.rules.numbers
        lane = int(len(self.scenario.rules.lanes) > 1)
        return 1 + lane * (first_lane < 0) + (vehicles - 1) * (lane + (8 if kind == LINEAR else 3))

    def reset_to(self, uniforms: FloatArray, which: Sequence[int]) -> NDArray[np.float32]:
        """Start episodes in scenes with chosen random numbers.

        Parameters
        ----------
        uniforms : the random numbers of each scene, (len(which), `draws`), each in [0, 1). Uniformly distributed
            numbers give the distribution of highway-env's scenes.
        which : the environments.

        Returns
        -------
        As of `reset`.

        Raises
        ------
        ConfigError
            If the simulator was built without `replay_draws`, or the numbers have another shape or range.
        """
        uniforms = np.asarray(uniforms, float)
        if self.worlds.rows.shape[1] <= WORDS:
            raise ConfigError("scenes of one's own choice need Simulator(..., replay_draws=True)")
        if uniforms.shape != (len(which), self.draws) or not ((uniforms >= 0) & (uniforms < 1)).all():
            raise ConfigError(f"have numbers from 0 to 1 of shape {(len(which), self.draws)}, not {uniforms.shape}")
        chosen = np.asarray(which, np.int64)
        self.worlds.rows[chosen, WORDS] = 1
        self.worlds.rows[chosen, REPLAY_START:] = np.ldexp(uniforms, 53).astype(np.uint64) << np.uint64(11)
        return self.reset(which=which)

    def new_worlds(self, count: int, words: int = WORDS) -> Worlds:
        """Buffers for `count` further environments of the same bodies."""
        m = self.scenario.bodies
        return Worlds(
            np.zeros((count, F, m)),
            np.zeros((count, G, m), np.int64),
            np.zeros((count, P, m)),
            np.zeros((count, m), np.int64),
            np.zeros((count, words), np.uint64),
            np.zeros(count),
        )

    def new_work(self) -> Work:
        """Buffers for the kernels of one further thread."""
        shape, scenario = self.scenario.observation_space.shape, self.scenario
        return _work(scenario.bodies, len(scenario.rules.lanes), shape[0], int(np.prod(shape[1:])))

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
        The observations of all environments, (e, bodies, features) float32. The next call overwrites the array.

        Raises
        ------
        ConfigError
            If an environment does not exist, a seed is invalid, or a live scene has other bodies than its
            configuration.
        """
        chosen, numbers = checked_resets(self.num_envs, seeds, which)
        self._check_configured()
        reset_all(self._simulation(self._works[0]), chosen, numbers)
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
        Observations (e, bodies, features), rewards (e,), terminated (e,) and truncated (e,). The next call overwrites
        the arrays.

        Raises
        ------
        ActionError
            If there is not one action for each environment, or one is not in the action space.
        ConfigError
            If `which` is not in increasing order, or an environment does not exist.
        """
        given, seen = self._given(actions), self.seen
        if again:
            self._check_configured()

        def part(k: int, first: int, last: int) -> None:
            step_all(self._simulation(self._works[k]), given, first, last, again)

        self._slices.run(part, checked_steps(self.num_envs, which))
        return seen.observations, seen.reward, seen.terminated, seen.truncated

    def _simulation(self, work: Work) -> Simulation:
        """What a step of the environments reads and writes, with the buffers of one thread."""
        scenario = self.scenario
        return Simulation(self.machine, self.worlds, scenario.rules, scenario.view, work, self.flat)

    def step_first(
        self, actions: Any, count: int
    ) -> tuple[NDArray[np.float32], FloatArray, NDArray[np.bool_], NDArray[np.bool_]]:
        """`step` of the first `count` environments only. The entries of the others stay unchanged."""
        given, seen = self._given(actions), self.seen
        step_all(self._simulation(self._works[0]), given, 0, count, False)
        return seen.observations, seen.reward, seen.terminated, seen.truncated

    def begin(self, action: Any) -> None:
        """Begin a decision in the only copy. `frame` and `finish` continue it."""
        begin(self.worlds, self.scenario.rules, 0, self._given(np.asarray(action)[None])[0])

    def frame(self, rows: FloatArray, throttle: float = np.nan, wheel: float = np.nan) -> bool:
        """One frame of the only copy; see `step_kernels.frame`."""
        work = self._works[0]
        return bool(frame(self._simulation(work), 0, throttle, wheel, rows))

    def write_rows(self, rows: FloatArray) -> bool:
        """The bodies of the only copy as rows; see `step_kernels.write_rows`."""
        return bool(write_rows(self.worlds, self.scenario.rules, 0, rows))

    def observe(self) -> NDArray[np.float32]:
        """The present observation of the ego of the only copy, also between two frames, (bodies, features). The next
        call overwrites the array."""
        scenario, work = self.scenario, self._works[0]
        observe(self.machine, self.worlds, scenario.rules, scenario.view, work, self.flat, 0)
        seen: NDArray[np.float32] = self.seen.observations[0]
        return seen

    def finish(self) -> StepResults:
        """End the decision that `begin` began, and return its results."""
        scenario, work = self.scenario, self._works[0]
        finish(self.machine, self.worlds, scenario.rules, scenario.view, work, self.flat, 0)
        return self.seen

    def _given(self, actions: Any) -> FloatArray:
        """Actions in the form of the kernels, (e, 2)."""
        return kernel_actions(actions, self.num_envs, len(self.scenario.rules.labels), self.scenario.inputs)


def _work(bodies: int, lanes: int, rows: int, features: int) -> Work:
    """Buffers for the kernels of one thread."""
    return Work(
        np.zeros((4, bodies)),
        np.zeros(bodies, np.int64),
        np.zeros((lanes, bodies), np.int64),
        np.zeros((lanes, bodies), np.int64),
        np.zeros((2, 5, 2)),
        np.zeros(max(1, bodies * (bodies - 1) // 2), np.int64),
        np.zeros((rows, features)),
    )
