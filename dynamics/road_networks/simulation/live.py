"""Copy a live highway-env on any road network into the arrays of the simulator, and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from highway_env.vehicle.controller import ControlledVehicle, MDPVehicle
from highway_env.vehicle.dynamics import BicycleVehicle
from highway_env.vehicle.kinematics import Vehicle

from dynamics.errors import SceneError
from dynamics.highway_simulator.layout import (
    ACC_MAX,
    ACCELERATION,
    ALLY,
    COMFORT,
    CONTINUOUS,
    CRASHED,
    EGO,
    HEADING,
    IMPACT_X,
    IMPACT_Y,
    IMPACTED,
    KIND,
    LANE,
    MAX_SPEED,
    MIN_SPEED,
    OBSTACLE,
    SPEED,
    STEERING,
    TARGET,
    TARGET_SPEED,
    TIMER,
    X,
    Y,
)
from dynamics.highway_simulator.live import bodies_of, check_body, check_egos, kind_in_scene, load_body
from dynamics.road_networks.geometry.layout import (
    ACROSS,
    ALONG,
    DYNAMICAL,
    FRAMES,
    LATERAL_SPEED,
    ROAD,
    ROUTE,
    ROUTE_END,
    YAW_RATE,
    YIELDS,
)
from dynamics.road_networks.simulation.frame_kernels import NetworkRules, NetworkWorlds

__all__ = ["length_of_route", "load", "load_ego", "longest_route", "store"]

LaneNumbers = Mapping[tuple[str, str, int], int]


def longest_route(env: Any) -> int:
    """Number of entries of the longest route of the vehicles."""
    return max(
        (len(getattr(v, "route", None) or ()) for v in bodies_of(env, first=False, multi_agent=True)[0]), default=0
    )


def length_of_route(base: Any) -> int:
    """Number of entries of the route of the ego of an environment, unwrapped. The other vehicles are not read.

    Raises
    ------
    SceneError
        If there is no ego on the road.
    """
    check_egos(base, first=False, multi_agent=True)
    return len(getattr(base.vehicle, "route", None) or ())


def load(env: Any, rules: NetworkRules, lanes: LaneNumbers, worlds: NetworkWorlds, e: int) -> None:
    """Copy a live environment into one of the scenes: between two decisions, or between two frames if the ego has
    throttle and steering.

    Parameters
    ----------
    lanes : the number of each lane by highway-env's index (see `network.index_of`).
    worlds, e : the scenes, and the index of the one that is written.

    Raises
    ------
    SceneError
        If the number of bodies does not fit, or a vehicle has an unknown driving model.
    """
    base = env.unwrapped
    vehicles, obstacles = bodies_of(env, first=False, multi_agent=True)
    f, g, p, routes = worlds.f[e], worlds.g[e], worlds.p[e], worlds.routes[e]
    inputs = type(base.vehicle) in (Vehicle, BicycleVehicle)
    if not inputs and type(base.vehicle) is not MDPVehicle:
        raise SceneError(f"the ego is a {type(base.vehicle).__name__}, and no MDPVehicle, Vehicle or BicycleVehicle")
    bodies = len(vehicles) + len(obstacles)
    any_number = rules.numbers[1] < 0
    if bodies > f.shape[1] or (not any_number and (len(vehicles), bodies) != (rules.numbers[1], f.shape[1])):
        raise SceneError(
            f"have {'room for' if any_number else f'{rules.numbers[1]} vehicles of'} {f.shape[1]} bodies, not "
            f"{len(vehicles)} vehicles and {len(obstacles)} obstacles"
        )
    if not inputs and base.steps % rules.numbers[0]:
        raise SceneError("the environment is amid a decision")
    f[:], g[:], routes[:] = 0.0, 0, -1
    for i, body in enumerate([*vehicles, *obstacles]):
        ego = any(body is each for each in base.controlled_vehicles)
        check_body(body, i, ego, rules.target_speeds)
        load_body(
            body,
            i,
            OBSTACLE if i >= len(vehicles) else CONTINUOUS if ego and inputs else kind_in_scene(body, ego),
            f,
            g,
            p,
        )
        g[LANE, i], g[TARGET, i] = lanes[_key(body.lane_index)], lanes[_key(body.lane_index)]
        f[ALONG, i], f[ACROSS, i] = body.lane.local_coordinates(body.position)
        if ego and body is not base.vehicle:
            g[KIND, i] = ALLY
        if ego and inputs:
            _load_inputs(base, i, rules, f, g, p)
        elif i < len(vehicles):
            g[TARGET, i] = lanes[_key(body.target_lane_index)]
            g[YIELDS, i] = getattr(body, "is_yielding", False)
            _load_route(body, i, rules, lanes, g, routes)
    g[FRAMES, 0] = getattr(base.road, "steps", 0)
    if not np.isfinite(f).all():
        raise SceneError("a position, heading, speed, target, timer or action of the scene is not finite")
    worlds.order[e] = np.arange(f.shape[1])
    worlds.clock[e], worlds.counts[e] = base.time, (len(vehicles), bodies)


def store(base: Any, keys: Sequence[tuple[str, str, int]], worlds: NetworkWorlds, e: int) -> None:
    """Write one of the scenes back into the environment, unwrapped, that it was loaded from. Its bodies must be the
    same and unchanged since.

    Parameters
    ----------
    keys : highway-env's index of each lane, by number.
    """
    f, g = worlds.f[e].T.tolist(), worlds.g[e].T.tolist()
    lanes = base.road.network.graph
    for i, (body, row, has) in enumerate(zip([*base.road.vehicles, *base.road.objects], f, g, strict=True)):
        body.crashed = bool(has[CRASHED])
        if has[KIND] == OBSTACLE:
            continue
        body.position, body.heading, body.speed = worlds.f[e, [X, Y], i], row[HEADING], row[SPEED]
        start, end, k = body.lane_index = keys[has[LANE]]
        body.lane = lanes[start][end][k]
        body.action = {"steering": row[STEERING], "acceleration": row[ACCELERATION]}
        body.impact = worlds.f[e, [IMPACT_X, IMPACT_Y], i] if has[IMPACTED] else None
        if has[DYNAMICAL]:
            body.lateral_speed, body.yaw_rate = row[LATERAL_SPEED], row[YAW_RATE]
        if isinstance(body, ControlledVehicle):
            body.target_lane_index, body.target_speed = keys[has[TARGET]], row[TARGET_SPEED]
            if body.route:
                del body.route[: len(body.route) - (has[ROUTE_END] - has[ROUTE])]
        if hasattr(body, "timer"):
            body.timer = row[TIMER]
        _store_yielding(base.road, body, bool(has[YIELDS]))
    if hasattr(base.road, "steps"):
        base.road.steps = int(worlds.g[e, FRAMES, 0])


def _store_yielding(road: Any, body: Any, yields: bool) -> None:
    """Mark a body as yielding, with the colour of highway-env, or remove the mark."""
    if yields:
        body.color, body.is_yielding, body.yield_timer = road.YIELDING_COLOR, True, 0
    elif getattr(body, "is_yielding", False):
        del body.color
        body.is_yielding = False


def load_ego(base: Any, rules: NetworkRules, lanes: LaneNumbers, worlds: NetworkWorlds) -> None:
    """Copy the ego of an environment, unwrapped, alone into the first scene. The ego takes meta-actions.

    Raises
    ------
    SceneError
        If the ego is no `MDPVehicle`, its route does not fit, or one of its numbers is not finite.
    """
    ego, f, g = base.vehicle, worlds.f[0], worlds.g[0]
    if type(ego) is not MDPVehicle:
        raise SceneError(f"the ego is a {type(ego).__name__}, and no MDPVehicle")
    check_body(ego, 0, True, rules.target_speeds)
    f[:], g[:], worlds.routes[:] = 0.0, 0, -1
    load_body(ego, 0, EGO, f, g, worlds.p[0])
    g[LANE], g[TARGET] = lanes[_key(ego.lane_index)], lanes[_key(ego.target_lane_index)]
    f[[ALONG, ACROSS], 0] = ego.lane.local_coordinates(ego.position)
    _load_route(ego, 0, rules, lanes, g, worlds.routes[0])
    if not np.isfinite(f).all():
        raise SceneError("a position, heading, speed, target or action of the ego is not finite")
    worlds.routes[1], worlds.p[1] = worlds.routes[0], worlds.p[0]


def _load_inputs(base: Any, i: int, rules: NetworkRules, f: Any, g: Any, p: Any) -> None:
    """Load the columns that only an ego with throttle and steering has."""
    if hasattr(base.action_type, "agents_action_types"):
        raise SceneError("several egos with throttle and steering are not simulated")
    g[ROUTE_END, i] = -1
    p[[ACC_MAX, COMFORT], i] = rules.control_limits
    if base.action_type.speed_range:
        # highway-env sets the range of speeds of the ego at its first action.
        p[[MIN_SPEED, MAX_SPEED], i] = base.action_type.speed_range
    if isinstance(base.vehicle, BicycleVehicle):
        g[DYNAMICAL, i] = 1
        f[[LATERAL_SPEED, YAW_RATE], i] = base.vehicle.lateral_speed, base.vehicle.yaw_rate


def _key(index: Any) -> tuple[str, str, int]:
    """highway-env's index of a lane, with 0 for an unknown number on its road."""
    return index[0], index[1], int(index[2] or 0)


def _load_route(body: Any, i: int, rules: NetworkRules, lanes: LaneNumbers, g: Any, routes: Any) -> None:
    """Copy the route of a body into row `i` of `routes`.

    Raises
    ------
    SceneError
        If it is longer than the row.
    """
    if body.route is None:
        g[ROUTE_END, i] = -1
        return
    route = body.route
    if len(route) > routes.shape[1]:
        raise SceneError(f"vehicle {i} has a route of {len(route)} roads; there is room for {routes.shape[1]}")
    g[ROUTE_END, i] = len(route)
    for k, (start, end, lane) in enumerate(route):
        first = lanes[start, end, 0]
        routes[i, k] = rules.network.ids[first, ROAD], -1 if lane is None else int(lane)
