"""The ego by itself on a road network: where highway-env's controllers, and braking, would take it.

It answers to nobody, so that what it does follows from what it is told, whatever the others do.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from highway_env.vehicle.controller import MDPVehicle

from dynamics.compiled import uncounted
from dynamics.errors import ConfigError, SceneError
from dynamics.highway_simulator.arithmetic import Sums, sums_of_numpy
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
from dynamics.highway_simulator.step_kernels import Machine
from dynamics.road_networks.geometry.layout import COUNT, FIRST, ID, ROAD
from dynamics.road_networks.geometry.network import index_of, network_of
from dynamics.road_networks.simulation.frame_kernels import (
    NetworkRules,
    NetworkWork,
    NetworkWorlds,
    intend,
    move,
    new_work,
    new_worlds,
    on_way,
)
from dynamics.road_networks.simulation.live import length_of_route, load_ego
from dynamics.road_networks.traffic.regulation import Customs
from dynamics.state import FloatArray, IntArray

__all__ = ["Alone", "Course", "alone_on", "drive"]

_REST = 1e-9
"""Who is no faster stands [m/s]."""


class Course(NamedTuple):
    """What the ego is told: to steer for a lane at a speed [m/s], braking for that no harder than `gentle` [m/s^2], for
    so many frames; and then to steer for the lane `aside` lanes to the right of the one it is bound for, and to brake
    as hard as `hard` [m/s^2] until it stands."""

    lane: int
    speed: float
    gentle: float
    frames: int
    aside: int
    hard: float


class Alone(NamedTuple):
    """The ego and its road; scene 0 is the present, and scene 1 what is tried."""

    machine: Machine
    worlds: NetworkWorlds
    rules: NetworkRules
    work: NetworkWork


def alone_on(base: Any) -> Alone:
    """The ego of an environment, unwrapped, with meta-actions.

    Raises
    ------
    ConfigError
        If it takes other actions.
    SceneError
        If its road has lanes of another shape.
    """
    labels = getattr(base.action_type, "actions", None)
    if labels is None or not isinstance(base.vehicle, MDPVehicle):
        raise ConfigError(f"the ego takes meta-actions here, not {type(base.action_type).__name__}")
    frequency = base.config["simulation_frequency"]
    rules = NetworkRules(
        network=network_of(base.road.network),
        customs=Customs(0, False, 0, 0),
        numbers=(int(frequency // base.config["policy_frequency"]), 1),
        times=(1 / frequency, 1 / base.config["policy_frequency"]),
        target_speeds=np.array(base.vehicle.target_speeds, float),
        labels=np.array([ACTIONS.index(labels[k]) for k in sorted(labels)], np.int64),
        law=(0.0, 0.0),
    )
    sums, products = sums_of_numpy()
    if Sums.OTHER in (sums, products):
        raise SceneError("numpy computes in a way that is not known here")
    worlds = new_worlds(2, 1, max(1, length_of_route(base)), 1)
    alone = Alone(Machine(sums, products, addresses()), worlds, rules, new_work(1))
    load_ego(base, rules, index_of(base.road.network), worlds)
    return alone


@uncounted
def drive(
    alone: Alone, course: Course, over: IntArray, path: FloatArray, first: FloatArray, bound: IntArray, own: IntArray
) -> int:
    """Follow a course from the present.

    Parameters
    ----------
    over : for each lane the one that one has to come over to, because it ends, -1 for none (`Ways`); nobody turns
        aside into one that ends.
    path : (K + 1, 4), written: x, y [m], heading [rad], speed [m/s].
    first : acceleration [m/s^2] and front wheel angle [rad] in the first frame, (2,), written.
    bound, own : the lane that it is bound for in each frame, and the one that it is on, (K + 1,), written.

    Returns
    -------
    How many rows there are until the ego stands, or its road has ended; negative, if it left the road, the number
    with a minus.
    """
    worlds, rules, dt = alone.worlds, alone.rules, alone.rules.times[0]
    f, g, f0, g0 = worlds.f[1], worlds.g[1], worlds.f[0], worlds.g[0]
    for k in range(f.shape[0]):
        f[k, 0] = f0[k, 0]
    for k in range(g.shape[0]):
        g[k, 0] = g0[k, 0]
    worlds.order[1, 0] = 0
    g[TARGET, 0], f[TARGET_SPEED, 0] = course.lane, course.speed
    path[0, 0], path[0, 1], path[0, 2], path[0, 3] = f[X, 0], f[Y, 0], f[HEADING, 0], f[SPEED, 0]
    own[0] = g[LANE, 0]
    for k in range(1, path.shape[0]):
        if k - 1 == course.frames and course.aside != 0:
            lane = g[TARGET, 0]
            ids = rules.network.ids
            index = ids[lane, ID] + course.aside
            beside = ids[lane, FIRST] + index
            if 0 <= index < ids[lane, COUNT] and ids[lane, ROAD] == ids[g[LANE, 0], ROAD] and over[beside] < 0:
                g[TARGET, 0] = beside
        intend(alone.machine, worlds, rules, alone.work, 1)
        speed = f[SPEED, 0]
        if k - 1 >= course.frames:
            f[ACCELERATION, 0] = max(-course.hard, -speed / dt) if speed > 0 else min(course.hard, -speed / dt)
        elif f[ACCELERATION, 0] < -course.gentle:
            f[ACCELERATION, 0] = max(-course.gentle, KP_A * (course.speed - speed))
        if k == 1:
            first[0], first[1] = f[ACCELERATION, 0], f[STEERING, 0]
        bound[k - 1] = g[TARGET, 0]
        move(alone.machine, worlds, rules, alone.work, 1)
        path[k, 0], path[k, 1], path[k, 2], path[k, 3] = f[X, 0], f[Y, 0], f[HEADING, 0], f[SPEED, 0]
        bound[k], own[k] = g[TARGET, 0], g[LANE, 0]
        on, at_end = on_way(rules, f, g)
        if not on:
            return -k - 1
        if at_end or (k > course.frames and abs(f[SPEED, 0]) <= _REST):
            return k + 1
    return path.shape[0]
