"""The ego alone on a road network: its path under highway-env's controllers and under braking.

These controllers do not react to other vehicles, so the path follows from the target command alone.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from highway_env.vehicle.controller import MDPVehicle

from dynamics.compiled import kernel_no_refcount
from dynamics.errors import ConfigError, SceneError
from dynamics.highway_simulator.arithmetic import Sums, sums_of_numpy
from dynamics.highway_simulator.arrays import Machine
from dynamics.highway_simulator.control import KP_A
from dynamics.highway_simulator.layout import (
    ACCELERATION,
    HEADING,
    LANE,
    SPEED,
    STEERING,
    TARGET,
    TARGET_SPEED,
    X,
    Y,
)
from dynamics.highway_simulator.loops import addresses
from dynamics.highway_simulator.scenario import ACTIONS
from dynamics.road_networks.geometry.layout import COUNT, FIRST, ID, ROAD
from dynamics.road_networks.geometry.network import index_of, network_of
from dynamics.road_networks.simulation.frame_kernels import (
    NetworkRules,
    NetworkWork,
    NetworkWorlds,
    compute_controls,
    move,
    new_work,
    new_worlds,
    on_way,
)
from dynamics.road_networks.simulation.live import length_of_route, load_ego
from dynamics.road_networks.traffic.regulation import TrafficRegulation
from dynamics.state import FloatArray, IntArray

__all__ = ["EgoManoeuvre", "EgoOnNetwork", "read_ego_on_network", "simulate_manoeuvre"]

_REST = 1e-9
"""Speed up to which a vehicle counts as standing [m/s]."""


class EgoManoeuvre(NamedTuple):
    """A candidate manoeuvre of the ego.

    Attributes
    ----------
    lane, speed : target lane, and target speed [m/s], for `frames` frames.
    gentle : greatest deceleration in these frames [m/s^2].
    aside : the target lane afterwards, counted to the right from the present target lane.
    hard : deceleration afterwards, until the ego stands [m/s^2].
    """

    lane: int
    speed: float
    gentle: float
    frames: int
    aside: int
    hard: float


class EgoOnNetwork(NamedTuple):
    """The ego and its road. Scene 0 is the present, scene 1 the simulated manoeuvre."""

    machine: Machine
    worlds: NetworkWorlds
    rules: NetworkRules
    work: NetworkWork


def read_ego_on_network(base: Any) -> EgoOnNetwork:
    """The ego of an environment, unwrapped, with meta-actions.

    Raises
    ------
    ConfigError
        If the ego takes other actions.
    SceneError
        If the road has lanes of an unknown shape, or the way in which numpy computes sums is unknown.
    """
    labels = getattr(base.action_type, "actions", None)
    if labels is None or not isinstance(base.vehicle, MDPVehicle):
        raise ConfigError(f"the ego takes meta-actions here, not {type(base.action_type).__name__}")
    frequency = base.config["simulation_frequency"]
    rules = NetworkRules(
        network=network_of(base.road.network),
        regulation=TrafficRegulation(0, False, 0, 0),
        numbers=(int(frequency // base.config["policy_frequency"]), 1),
        times=(1 / frequency, 1 / base.config["policy_frequency"]),
        target_speeds=np.array(base.vehicle.target_speeds, float),
        labels=np.array([ACTIONS.index(labels[k]) for k in sorted(labels)], np.int64),
        control_limits=(0.0, 0.0),
    )
    sums, products = sums_of_numpy()
    if Sums.OTHER in (sums, products):
        raise SceneError("numpy computes in a way that is not known here")
    worlds = new_worlds(2, 1, max(1, length_of_route(base)), 1)
    alone = EgoOnNetwork(Machine(sums, products, addresses()), worlds, rules, new_work(1))
    load_ego(base, rules, index_of(base.road.network), worlds)
    return alone


@kernel_no_refcount
def simulate_manoeuvre(
    alone: EgoOnNetwork,
    manoeuvre: EgoManoeuvre,
    over: IntArray,
    path: FloatArray,
    first: FloatArray,
    bound: IntArray,
    own: IntArray,
) -> int:
    """Simulate a manoeuvre from the present scene.

    Parameters
    ----------
    over : for each lane that ends, the neighbouring lane that a vehicle has to change to, -1 for other lanes
        (`LaneContinuations`). The ego does not turn aside into a lane that ends.
    path : (K + 1, 4), written: x, y [m], heading [rad], speed [m/s].
    first : acceleration [m/s^2] and front wheel angle [rad] in the first frame, (2,), written.
    bound, own : target lane and present lane in each frame, (K + 1,), written.

    Returns
    -------
    Number of rows until the ego stands or its road ends, K + 1 if neither happens; the negative of that number if it
    left the road.
    """
    worlds, rules, dt = alone.worlds, alone.rules, alone.rules.times[0]
    f, g, f0, g0 = worlds.f[1], worlds.g[1], worlds.f[0], worlds.g[0]
    for k in range(f.shape[0]):
        f[k, 0] = f0[k, 0]
    for k in range(g.shape[0]):
        g[k, 0] = g0[k, 0]
    worlds.order[1, 0] = 0
    g[TARGET, 0], f[TARGET_SPEED, 0] = manoeuvre.lane, manoeuvre.speed
    path[0, 0], path[0, 1], path[0, 2], path[0, 3] = f[X, 0], f[Y, 0], f[HEADING, 0], f[SPEED, 0]
    own[0] = g[LANE, 0]
    for k in range(1, path.shape[0]):
        if k - 1 == manoeuvre.frames and manoeuvre.aside != 0:
            lane = g[TARGET, 0]
            ids = rules.network.ids
            index = ids[lane, ID] + manoeuvre.aside
            beside = ids[lane, FIRST] + index
            if 0 <= index < ids[lane, COUNT] and ids[lane, ROAD] == ids[g[LANE, 0], ROAD] and over[beside] < 0:
                g[TARGET, 0] = beside
        compute_controls(alone.machine, worlds, rules, alone.work, 1)
        speed = f[SPEED, 0]
        if k - 1 >= manoeuvre.frames:
            f[ACCELERATION, 0] = max(-manoeuvre.hard, -speed / dt) if speed > 0 else min(manoeuvre.hard, -speed / dt)
        elif f[ACCELERATION, 0] < -manoeuvre.gentle:
            f[ACCELERATION, 0] = max(-manoeuvre.gentle, KP_A * (manoeuvre.speed - speed))
        if k == 1:
            first[0], first[1] = f[ACCELERATION, 0], f[STEERING, 0]
        bound[k - 1] = g[TARGET, 0]
        move(alone.machine, worlds, rules, alone.work, 1)
        path[k, 0], path[k, 1], path[k, 2], path[k, 3] = f[X, 0], f[Y, 0], f[HEADING, 0], f[SPEED, 0]
        bound[k], own[k] = g[TARGET, 0], g[LANE, 0]
        on, at_end = on_way(rules, f, g)
        if not on:
            return -k - 1
        if at_end or (k > manoeuvre.frames and abs(f[SPEED, 0]) <= _REST):
            return k + 1
    return path.shape[0]
