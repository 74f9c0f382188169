"""Kernels for one frame of many scenes on one road network."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.arrays import Machine
from dynamics.highway_simulator.collisions import BodiesByX, collide
from dynamics.highway_simulator.layout import (
    ACCELERATION,
    CONTINUOUS,
    COS,
    EGO,
    HEADING,
    IMPACTED,
    KIND,
    LANE,
    LANE_LENGTH,
    LENGTH,
    OBSTACLE,
    SIN,
    SPEED,
    STEERING,
    TARGET,
    TARGET_SPEED,
    P,
    X,
    Y,
)
from dynamics.highway_simulator.motion import bicycle, limit
from dynamics.highway_simulator.neighbours import sort
from dynamics.highway_simulator.scene import next_target_speed
from dynamics.road_networks.geometry.lanes import NetworkLanes, after_end, closest, on_lane, reachable
from dynamics.road_networks.geometry.layout import (
    ACROSS,
    ALONG,
    COUNT,
    DYNAMICAL,
    ENDS,
    FIRST,
    FRAMES,
    ID,
    USES_CONTROLLERS,
    F,
    G,
)
from dynamics.road_networks.geometry.network import Network
from dynamics.road_networks.geometry.routes import NetworkTraffic, follow_road
from dynamics.road_networks.traffic.constant_inputs import slipping_bicycle
from dynamics.road_networks.traffic.driving import act
from dynamics.road_networks.traffic.regulation import INSTANTS, TrafficRegulation, regulate, remove_leaving
from dynamics.state import FloatArray, IntArray

__all__ = [
    "NetworkRules",
    "NetworkWork",
    "NetworkWorlds",
    "advance",
    "begin",
    "command",
    "compute_controls",
    "ego_of",
    "hold",
    "move",
    "new_work",
    "new_worlds",
    "on_way",
    "traffic_of",
]


class NetworkWorlds(NamedTuple):
    """The state of e scenes of m bodies (see `layout`).

    Attributes
    ----------
    f, g, p : (e, F, m), (e, G, m) and (e, P, m).
    order : (e, m), bodies by x.
    routes : (e, m, entries, 2): roads, and their lanes or -1.
    clock : (e,), time since the reset [s].
    counts : (e, 2), number of vehicles, and number of bodies. Obstacles come after the vehicles, then unused columns.
    """

    f: FloatArray
    g: IntArray
    p: FloatArray
    order: IntArray
    routes: IntArray
    clock: FloatArray
    counts: IntArray


class NetworkRules(NamedTuple):
    """The constants of all scenes.

    Attributes
    ----------
    network : the road. regulation : its rules beside driving.
    numbers : frames of a decision; number of vehicles of a scene, -1 for any number.
    times : duration of a frame and of a decision [s].
    target_speeds : of the ego [m/s]. labels : of each action: 0 left, 1 none, 2 right, 3 faster, 4 slower.
    control_limits : greatest deceleration and acceleration of an ego with throttle and steering that follows
        controllers [m/s^2].
    """

    network: Network
    regulation: TrafficRegulation
    numbers: tuple[int, int]
    times: tuple[float, float]
    target_speeds: FloatArray
    labels: IntArray
    control_limits: tuple[float, float]


class NetworkWork(NamedTuple):
    """Buffers of the kernels, overwritten."""

    numbers: FloatArray
    busy: IntArray
    corners: FloatArray
    pairs: IntArray
    paths: FloatArray


def new_worlds(count: int, bodies: int, entries: int, vehicles: int) -> NetworkWorlds:
    """Buffers for `count` scenes of `bodies` bodies, of which `vehicles` are vehicles, with routes of up to `entries`
    entries."""
    return NetworkWorlds(
        np.zeros((count, F, bodies)),
        np.zeros((count, G, bodies), np.int64),
        np.zeros((count, P, bodies)),
        np.zeros((count, bodies), np.int64),
        np.full((count, bodies, entries, 2), -1, np.int64),
        np.zeros(count),
        np.tile([vehicles, bodies], (count, 1)),
    )


def new_work(bodies: int) -> NetworkWork:
    """Buffers for the kernels of one thread."""
    return NetworkWork(
        np.zeros((4, bodies)),
        np.zeros(bodies, np.int64),
        np.zeros((2, 5, 2)),
        np.zeros(max(1, bodies * (bodies - 1) // 2), np.int64),
        np.zeros((bodies, INSTANTS, 6)),
    )


@kernel_inline
def ego_of(g: IntArray) -> int:
    """The column of the ego."""
    ego = 0
    while g[KIND, ego] != EGO and g[KIND, ego] != CONTINUOUS:
        ego += 1
    return ego


@kernel_inline
def hold(worlds: NetworkWorlds, e: int, throttle: float, wheel: float) -> None:
    """Set a constant acceleration [m/s^2] and front wheel angle [rad] of the ego of a scene, from now on."""
    f, g = worlds.f[e], worlds.g[e]
    ego = ego_of(g)
    f[ACCELERATION, ego], f[STEERING, ego], g[USES_CONTROLLERS, ego] = throttle, wheel, 0


@kernel_inline
def _lanes(machine: Machine, network: Network) -> NetworkLanes:
    return NetworkLanes(machine.sums, machine.loops, network.lanes, network.ids, network.near)


@kernel_inline
def traffic_of(machine: Machine, worlds: NetworkWorlds, network: Network, e: int) -> NetworkTraffic:
    """The road and the bodies of one scene."""
    lanes, bodies = _lanes(machine, network), worlds.counts[e, 1]
    return NetworkTraffic(lanes, network, worlds.f[e], worlds.g[e], worlds.p[e], worlds.routes[e], bodies)


@kernel_no_refcount
def command(machine: Machine, worlds: NetworkWorlds, rules: NetworkRules, e: int, ego: int, action: int) -> None:
    """Apply a meta-action to the target command of an ego, given by its column."""
    f, g, network, label = worlds.f[e], worlds.g[e], rules.network, rules.labels[action]
    traffic = traffic_of(machine, worlds, network, e)
    if g[KIND, ego] == CONTINUOUS and not g[USES_CONTROLLERS, ego]:
        g[USES_CONTROLLERS, ego], g[TARGET, ego], f[TARGET_SPEED, ego] = 1, g[LANE, ego], f[SPEED, ego]
    follow_road(traffic, ego)
    if label >= 3:
        f[TARGET_SPEED, ego] = next_target_speed(rules.target_speeds, f[SPEED, ego], label)
    elif label != 1:
        ids, target = network.ids, g[TARGET, ego]
        lane = ids[target, FIRST] + min(max(ids[target, ID] + label - 1, 0), ids[target, COUNT] - 1)
        if reachable(traffic.lanes, lane, f[X, ego], f[Y, ego]):
            g[TARGET, ego] = lane


@kernel_no_refcount
def begin(machine: Machine, worlds: NetworkWorlds, rules: NetworkRules, e: int, action: FloatArray) -> None:
    """Begin a decision in one scene: apply the action to the target command.

    highway-env has no meta-actions for an ego with throttle and steering. Here such an ego then follows highway-env's
    controllers, starting from its present lane and speed.
    """
    worlds.clock[e] += rules.times[1]
    command(machine, worlds, rules, e, ego_of(worlds.g[e]), int(action[0]))


@kernel_no_refcount
def compute_controls(machine: Machine, worlds: NetworkWorlds, rules: NetworkRules, work: NetworkWork, e: int) -> None:
    """Compute the controls of all vehicles in one scene for the coming frame."""
    g, vehicles = worlds.g[e], worlds.counts[e, 0]
    traffic = traffic_of(machine, worlds, rules.network, e)
    remove_leaving(traffic, rules.regulation, vehicles)
    act(traffic, work.numbers, work.busy, vehicles)
    g[FRAMES, 0] += 1
    if rules.regulation.period > 0 and g[FRAMES, 0] % rules.regulation.period == 0:
        regulate(traffic, rules.regulation, machine.products, work.numbers, work.busy, work.paths, vehicles)


@kernel_inline
def _go_straight(f: FloatArray, p: FloatArray, i: int, dt: float) -> None:
    """`bicycle` with zero steering: the heading, its cosine and its sine stay the same, except for signs of zeros."""
    speed, wheel = f[SPEED, i], f[STEERING, i]
    course = f[HEADING, i] + wheel
    f[X, i] += speed * f[COS, i] * dt
    f[Y, i] += speed * (course if course == 0.0 else f[SIN, i]) * dt
    f[HEADING, i] += speed * wheel / (p[LENGTH, i] / 2) * dt
    f[SPEED, i] += f[ACCELERATION, i] * dt
    if f[HEADING, i] == 0.0:
        f[SIN, i] = f[HEADING, i]


@kernel_no_refcount
def move(machine: Machine, worlds: NetworkWorlds, rules: NetworkRules, work: NetworkWork, e: int) -> None:
    """Move all vehicles in one scene by a frame."""
    f, g, p, vehicles, dt = worlds.f[e], worlds.g[e], worlds.p[e], worlds.counts[e, 0], rules.times[0]
    lanes, order, n = _lanes(machine, rules.network), worlds.order[e][: worlds.counts[e, 1]], 0
    for i in range(vehicles):
        limit(f, g, p, i, dt)
        if g[DYNAMICAL, i]:
            slipping_bicycle(machine.loops, machine.products, f, i, dt)
            continue
        if f[STEERING, i] == 0.0 and not g[IMPACTED, i]:
            _go_straight(f, p, i, dt)
            continue
        work.busy[n] = i
        n += 1
    bicycle(machine.loops, f, g, p, work.numbers, work.busy, n, dt)
    for i in range(vehicles):
        if g[KIND, i] == OBSTACLE:
            continue
        g[LANE, i], f[ALONG, i], f[ACROSS, i] = closest(lanes, f[X, i], f[Y, i], f[HEADING, i], g[LANE, i])
    sort(f, order)
    collide(machine, BodiesByX(f, g, p, order, vehicles), work.corners, work.pairs, dt)


@kernel_no_refcount
def advance(machine: Machine, worlds: NetworkWorlds, rules: NetworkRules, work: NetworkWork, e: int) -> None:
    """Advance one scene by a frame."""
    compute_controls(machine, worlds, rules, work, e)
    move(machine, worlds, rules, work, e)


@kernel_no_refcount
def on_way(rules: NetworkRules, f: FloatArray, g: IntArray) -> tuple[bool, bool]:
    """Whether the ego is on the lane that is closest to it, and whether it is at the end of a lane without a next one.
    An ego that can stop is off the road there."""
    ego = ego_of(g)
    network, lane = rules.network, g[LANE, ego]
    s, r = f[ALONG, ego], f[ACROSS, ego]
    at_end = network.ids[lane, ENDS] != 0 and after_end(network.lanes, lane, s)
    if at_end and rules.target_speeds[0] <= 0:
        return False, False
    return on_lane(network.lanes, lane, min(s, network.lanes[lane, LANE_LENGTH]) if at_end else s, r, 0.0), at_end
