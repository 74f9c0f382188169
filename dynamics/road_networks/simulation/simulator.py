"""`NetworkSimulator`: copies of one live highway-env on any road network, frame by frame."""

from __future__ import annotations

from typing import Any, cast

import gymnasium as gym
import numpy as np
from highway_env.envs.common.action import ContinuousAction, MultiAgentAction

from dynamics.compiled import kernel_no_refcount
from dynamics.errors import ConfigError, SceneError
from dynamics.highway_simulator.arithmetic import Sums, sums_of_numpy
from dynamics.highway_simulator.arrays import Machine
from dynamics.highway_simulator.layout import LANE
from dynamics.highway_simulator.live import bodies_of
from dynamics.highway_simulator.loops import addresses
from dynamics.highway_simulator.scenario import ACTIONS
from dynamics.highway_simulator.step_kernels import write_row
from dynamics.road_networks.geometry.lanes import on_lane
from dynamics.road_networks.geometry.layout import ACROSS, ALONG
from dynamics.road_networks.geometry.network import index_of, network_of
from dynamics.road_networks.simulation.frame_kernels import (
    NetworkRules,
    NetworkWork,
    NetworkWorlds,
    advance,
    begin,
    ego_of,
    hold,
    new_work,
    new_worlds,
)
from dynamics.road_networks.simulation.live import load, longest_route, store
from dynamics.road_networks.simulation.supported_traffic import exits_of, traffic_regulation_of
from dynamics.state import BoolArray, FloatArray

__all__ = ["NetworkSimulator"]

_FASTEST = 30.0
"""Greatest target speed where no lane has a speed limit [m/s]."""


class NetworkSimulator:
    """Copies of a live environment in its present state, between two decisions.

    It simulates motion only. Observations, rewards and the end of an episode remain with the environment. So do
    vehicles that appear or vanish during an episode.

    Parameters
    ----------
    env : a highway-env environment, reset. Of several egos with meta-actions, `step` moves the first; the others
        continue with their present target commands.
    num_envs : number of copies.
    control_limits : for an ego with throttle and steering: greatest deceleration and acceleration of the controllers
        that carry out meta-actions [m/s^2], and the duration of each meta-action [s].
    like : another simulator of the same environment since its reset; its arrays of the road are reused.

    Raises
    ------
    ConfigError
        If the actions are neither meta-actions nor throttle and steering.
    SceneError
        If the road has lanes of an unknown shape, or a vehicle has an unknown driving model.

    Attributes
    ----------
    rules, worlds : for the kernels (see `frame_kernels`).
    exact : whether the way in which this machine's numpy computes sums of products is known.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        num_envs: int = 1,
        control_limits: tuple[float, float, float] = (9.8, 5.0, 1.0),
        like: NetworkSimulator | None = None,
    ) -> None:
        base = cast(Any, env.unwrapped)
        vehicles, obstacles = bodies_of(env, first=False, multi_agent=True)
        config, road, action_type = base.config, base.road, base.action_type
        if isinstance(action_type, MultiAgentAction):
            action_type = action_type.agents_action_types[0]
        frequency, frames = config["simulation_frequency"], config["simulation_frequency"] // config["policy_frequency"]
        labels, self._inputs = getattr(action_type, "actions", None), False
        if len(base.controlled_vehicles) > 1 and labels is None:
            raise ConfigError(f"several egos take meta-actions, not {type(action_type).__name__}")
        if isinstance(action_type, ContinuousAction):
            self._inputs, labels, frames = True, dict(enumerate(ACTIONS)), max(1, round(control_limits[2] * frequency))
        if labels is None:
            raise ConfigError(
                f"a network's ego takes meta-actions or throttle and steering, not {type(action_type).__name__}"
            )
        self._network = road.network
        if like is None or like._network is not road.network:
            self._lanes = index_of(road.network)
            network = network_of(road.network, bool(road.neighbour_vehicles_connected_lanes), exits_of(base))
        else:
            self._lanes, network = like._lanes, like.rules.network
        self._keys = tuple(self._lanes)
        self.rules: NetworkRules = NetworkRules(
            network=network,
            regulation=traffic_regulation_of(base),
            numbers=(int(frames), len(vehicles)),
            times=(1 / frequency, frames / frequency if self._inputs else 1 / config["policy_frequency"]),
            target_speeds=_speeds(road.network) if self._inputs else np.array(base.vehicle.target_speeds, float),
            labels=np.array([ACTIONS.index(labels[k]) for k in sorted(labels)], np.int64),
            control_limits=control_limits[:2],
        )
        sums, products = sums_of_numpy()
        self.exact = Sums.OTHER not in (sums, products)
        self.machine = Machine(sums, products, addresses())
        self.num_envs, self._bodies = num_envs, len(vehicles) + len(obstacles)
        self._entries = max(1, longest_route(env))
        self.worlds, self._work, self._given = self.new_worlds(num_envs), self.new_work(), np.zeros(2)
        self._rows = np.zeros((self.rules.numbers[0], self._bodies, 7))
        self._on_road = np.zeros(self.rules.numbers[0], np.bool_)
        for e in range(num_envs):
            self.load(env, e)

    def is_on(self, env: gym.Env[Any, Any]) -> bool:
        """Whether an environment has the road from which this simulator was built."""
        return cast(Any, env.unwrapped).road.network is self._network

    def fits(self, env: gym.Env[Any, Any]) -> bool:
        """Whether `load` accepts an environment: same road, same frequencies and as many bodies."""
        base = cast(Any, env.unwrapped)
        road, config = base.road, base.config
        same = road is not None and road.network is self._network and len(road.vehicles) == self.rules.numbers[1]
        frame, decision = 1 / config["simulation_frequency"], 1 / config["policy_frequency"]
        same = same and frame == self.rules.times[0] and (self._inputs or decision == self.rules.times[1])
        return same and len(road.objects) + len(road.vehicles) == self._bodies and longest_route(env) <= self._entries

    def load(self, env: gym.Env[Any, Any], e: int = 0) -> None:
        """Copy the environment, in its present state, into copy `e`; see `live.load`.

        Raises
        ------
        SceneError
            If the environment has another road, or see `live.load`.
        """
        if cast(Any, env.unwrapped).road.network is not self._network:
            raise SceneError("the environment has another road than the simulator; make a new one")
        load(env, self.rules, self._lanes, self.worlds, e)

    def store(self, env: gym.Env[Any, Any], e: int = 0) -> None:
        """Write copy `e` back into the environment that it was loaded from, which must not have changed since. Its
        clock and its count of frames are left unchanged."""
        store(env.unwrapped, self._keys, self.worlds, e)

    def new_worlds(self, count: int) -> NetworkWorlds:
        """Buffers for `count` further scenes of the same bodies."""
        return new_worlds(count, self._bodies, self._entries, self.rules.numbers[1])

    def new_work(self) -> NetworkWork:
        """Buffers for the kernels of one further thread."""
        return new_work(self._bodies)

    def step(self, action: int, e: int = 0) -> FloatArray:
        """Execute a meta-action for all of its frames.

        Returns
        -------
        The bodies after each frame, (frames, m, 7): x, y [m], heading [rad], speed [m/s], length, width [m], crashed.
        The next call overwrites the array.

        Raises
        ------
        ConfigError
            If there is no such action.
        """
        if not 0 <= action < len(self.rules.labels):
            raise ConfigError(f"have actions 0 to {len(self.rules.labels) - 1}, not {action}")
        self._given[0] = action
        _step(self.machine, self.worlds, self.rules, self._work, e, self._given, (self._rows, self._on_road))
        return self._rows

    def go_on(self, frames: int, e: int = 0) -> tuple[FloatArray, BoolArray]:
        """Simulate frames in which all vehicles continue: egos with their present target commands, traffic by its
        driving models.

        Returns
        -------
        As of `step`, (frames, m, 7), and whether the ego is on the road after each frame, (frames,).
        """
        rows, on_road = np.zeros((frames, self._bodies, 7)), np.zeros(frames, np.bool_)
        _go_on(self.machine, self.worlds, self.rules, self._work, e, (rows, on_road))
        return rows, on_road

    def hold(self, throttle: float, wheel: float, frames: int, e: int = 0) -> FloatArray:
        """Simulate frames in which the ego keeps an acceleration [m/s^2] and a front wheel angle [rad].

        Returns
        -------
        As of `step`, (frames, m, 7).

        Raises
        ------
        ConfigError
            If the ego takes meta-actions.
        """
        if not self._inputs:
            raise ConfigError("the ego takes meta-actions; use step")
        hold(self.worlds, e, throttle, wheel)
        return self.go_on(frames, e)[0]


def _speeds(network: Any) -> FloatArray:
    """Four target speeds at equal distances from 0 to the highest speed limit of a network [m/s]."""
    limits = [lane.speed_limit for lane in network.lanes_list() if lane.speed_limit is not None]
    return np.linspace(0.0, max(limits, default=_FASTEST), 4)


@kernel_no_refcount
def _go_on(
    machine: Machine,
    worlds: NetworkWorlds,
    rules: NetworkRules,
    work: NetworkWork,
    e: int,
    out: tuple[FloatArray, BoolArray],
) -> None:
    """`NetworkSimulator.go_on` as a kernel; `out` is its result, written."""
    rows, on_road = out
    f, g, p = worlds.f[e], worlds.g[e], worlds.p[e]
    ego = ego_of(g)
    for k in range(rows.shape[0]):
        advance(machine, worlds, rules, work, e)
        on_road[k] = on_lane(rules.network.lanes, g[LANE, ego], f[ALONG, ego], f[ACROSS, ego], 0.0)
        for i in range(f.shape[1]):
            write_row(f, g, p, i, rows[k, i])


@kernel_no_refcount
def _step(
    machine: Machine,
    worlds: NetworkWorlds,
    rules: NetworkRules,
    work: NetworkWork,
    e: int,
    action: FloatArray,
    out: tuple[FloatArray, BoolArray],
) -> None:
    """`NetworkSimulator.step` as a kernel; `out` is its result, written."""
    begin(machine, worlds, rules, e, action)
    _go_on(machine, worlds, rules, work, e, out)
