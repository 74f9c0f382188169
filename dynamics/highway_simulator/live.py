"""Copy a live highway-env into the simulator's arrays, and back."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, cast

import gymnasium as gym
import numpy as np
from highway_env.road.lane import StraightLane
from highway_env.vehicle.controller import ControlledVehicle, MDPVehicle
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Obstacle

from dynamics.errors import ConfigError, SceneError
from dynamics.highway_simulator.arrays import Worlds
from dynamics.highway_simulator.kinds import CONSTANTS, constants_of, kind_of
from dynamics.highway_simulator.lanes import lanes_at
from dynamics.highway_simulator.layout import (
    A_SPEED,
    ACCELERATION,
    CHANGES,
    CHECKS,
    CONTINUOUS,
    COS,
    CRASHED,
    DELTA,
    DIAGONAL,
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
    ON,
    S_HEADING,
    SIN,
    SPEED,
    STALE,
    STEERING,
    TARGET,
    TARGET_SPEED,
    TIMER,
    X,
    Y,
)
from dynamics.highway_simulator.random import WORDS, from_generator, to_generator
from dynamics.highway_simulator.scenario import Scenario
from dynamics.state import FloatArray

__all__ = ["bodies_of", "check_body", "check_egos", "kind_in_scene", "load", "load_body", "store"]


def bodies_of(env: gym.Env[Any, Any], first: bool = True, multi_agent: bool = False) -> tuple[list[Any], list[Any]]:
    """The vehicles and the obstacles of a live environment.

    Parameters
    ----------
    first : whether the ego has to be the first of the vehicles. multi_agent : whether there may be several egos.

    Raises
    ------
    SceneError
        If there are more egos than allowed, the ego is not where expected, or another object stands on the road.
    """
    base = cast(Any, env.unwrapped)
    check_egos(base, first, multi_agent)
    strange = [type(o).__name__ for o in base.road.objects if type(o) is not Obstacle]
    if strange:
        raise SceneError(f"the simulator knows obstacles, not {', '.join(strange)}")
    return base.road.vehicles, base.road.objects


def check_egos(base: Any, first: bool = True, multi_agent: bool = False) -> None:
    """Check that the ego of an environment, unwrapped, is on its road; parameters as of `bodies_of`.

    Raises
    ------
    SceneError
        If there are more egos than allowed, or the ego is not where expected.
    """
    egos = len(base.controlled_vehicles)
    vehicles = [] if base.road is None or egos == 0 or (egos > 1 and not multi_agent) else base.road.vehicles
    if not any(v is base.vehicle for v in (vehicles[:1] if first else vehicles)):
        where = "first of" if first else "among"
        raise SceneError(f"have one ego, {where} the vehicles on the road; is the environment reset?")


def load(env: gym.Env[Any, Any], scenario: Scenario, worlds: Worlds, e: int) -> None:
    """Copy a live environment, between two decisions, into one of the simulator's.

    Raises
    ------
    SceneError
        If its road or its bodies differ from the simulator's, or a vehicle has an unknown driving model.
    """
    base = cast(Any, env.unwrapped)
    vehicles, obstacles = bodies_of(env)
    _check_clock(base, scenario)
    f, g, p, lanes = worlds.f[e], worlds.g[e], worlds.p[e], scenario.rules.lanes
    if len(vehicles) != scenario.rules.numbers[1] or len(vehicles) + len(obstacles) != f.shape[1]:
        raise SceneError(
            f"have {scenario.rules.numbers[1]} vehicles of {f.shape[1]} bodies, not {len(vehicles)} of "
            f"{len(vehicles) + len(obstacles)}"
        )
    _check_road(base.road.network, lanes)
    f[:], g[:] = 0.0, 0
    for i, body in enumerate([*vehicles, *obstacles]):
        check_body(body, i, i == 0, scenario.rules.target_speeds)
        if getattr(body, "route", None):
            raise SceneError(f"body {i} ({type(body).__name__}) follows a route")
        load_body(body, i, OBSTACLE if i >= len(vehicles) else kind_in_scene(body, i == 0), f, g, p)
        g[LANE, i], g[TARGET, i] = body.lane_index[2], getattr(body, "target_lane_index", body.lane_index)[2]
        g[STALE, i], g[ON, i] = 1, lanes_at(lanes, f[X, i], f[Y, i])
    if g[KIND, 0] != scenario.rules.numbers[4]:
        raise SceneError("the ego takes meta-actions in one of the two, and throttle and steering in the other")
    if not np.isfinite(f).all():
        raise SceneError("a position, heading, speed, target, timer or action of the scene is not finite")
    if g[KIND, 0] == CONTINUOUS:
        # highway-env sets the range of speeds of the ego at its first action.
        p[[MAX_SPEED, MIN_SPEED], 0] = scenario.rules.constants[0][[MAX_SPEED, MIN_SPEED]]
    worlds.order[e] = np.arange(f.shape[1])
    worlds.rows[e, :WORDS] = from_generator(base.np_random)
    worlds.clock[e] = base.time


def _check_clock(base: Any, scenario: Scenario) -> None:
    """Check that decisions, frames and observations are those of the simulator.

    Raises
    ------
    SceneError
        If not.
    """
    frames, config = scenario.rules.numbers[0], base.config
    times = 1 / config["simulation_frequency"], 1 / config["policy_frequency"]
    lasts = not scenario.observes or float(config["duration"]) == scenario.rules.times[2]
    if times != scenario.rules.times[:2] or not lasts or base.steps % frames:
        raise SceneError("the environment has other frequencies than the simulator, or is amid a decision")
    if scenario.observes and base.observation_space.shape != scenario.observation_space.shape:
        raise SceneError("the environment's observations are not those of its configuration; reset it first")
    if not isinstance(base.np_random.bit_generator, np.random.PCG64):
        raise SceneError(f"the environment draws from {type(base.np_random.bit_generator).__name__}, not from PCG64")


@lru_cache
def _of_class(kind: type[Any]) -> frozenset[str]:
    """The names of a class's attributes."""
    return frozenset(dir(kind))


def check_body(body: Any, i: int, ego: bool, target_speeds: FloatArray) -> None:
    """Check that a body overrides no attribute or method that the simulator does not support.

    Raises
    ------
    SceneError
        If it does, if it is not solid or collidable, or if it has other target speeds.
    """
    name = f"body {i} ({type(body).__name__})"
    if not (body.solid and body.collidable):
        raise SceneError(f"{name} is not solid or not collidable")
    kind: Any = type(body)
    own = set(vars(body)).intersection(_of_class(kind)) - CONSTANTS - {"act"}
    if not ego and "act" in vars(body):
        own.add("act")
    if own:
        raise SceneError(f"{name} has a {', '.join(sorted(own))} of its own")
    if isinstance(body, MDPVehicle) and not np.array_equal(body.target_speeds, target_speeds):
        raise SceneError(f"{name} has other target speeds than the simulator's")


def _check_road(network: Any, lanes: FloatArray) -> None:
    """Check that the road consists of the straight lanes of the simulator.

    Raises
    ------
    SceneError
        If not.
    """
    real = network.lanes_list()
    if (
        len(real) != len(lanes)
        or any(type(lane) is not StraightLane or lane.forbidden for lane in real)
        or any(
            (*lane.start, *lane.end, lane.width, lane.speed_limit) != (0.0, y, length, y, width, limit)
            for lane, (y, width, length, limit) in zip(real, lanes, strict=True)
        )
    ):
        raise SceneError(f"the road is not the {len(lanes)} straight lanes of the simulator")


def kind_in_scene(body: Any, ego: bool) -> int:
    """The kind of a vehicle (see `layout`).

    Raises
    ------
    SceneError
        If its driving model is unknown.
    """
    if not ego:
        try:
            return kind_of(type(body))
        except ConfigError as error:
            raise SceneError(str(error)) from None
    if type(body) is MDPVehicle:
        return EGO
    if type(body) is Vehicle:
        return CONTINUOUS
    raise SceneError(f"the ego is a {type(body).__name__}; the simulator knows MDPVehicle and Vehicle")


def load_body(body: Any, i: int, kind: int, f: FloatArray, g: Any, p: FloatArray) -> None:
    """Copy a body of a kind into column `i`, without its lanes and its route."""
    f[X, i], f[Y, i] = body.position
    f[HEADING, i], f[SPEED, i] = body.heading, body.speed
    f[COS, i], f[SIN, i] = np.cos(body.heading), np.sin(body.heading)
    g[CRASHED, i], g[CHECKS, i] = body.crashed, body.check_collisions
    p[:, i] = constants_of(body)
    p[DIAGONAL, i] = body.diagonal
    g[KIND, i] = kind
    if kind == OBSTACLE:
        return
    f[STEERING, i], f[ACCELERATION, i] = body.action["steering"], body.action["acceleration"]
    if body.impact is not None:
        g[IMPACTED, i] = 1
        f[IMPACT_X, i], f[IMPACT_Y, i] = body.impact
    f[TARGET_SPEED, i] = getattr(body, "target_speed", 0.0)
    f[TIMER, i], g[CHANGES, i] = getattr(body, "timer", 0.0), getattr(body, "enable_lane_change", True)


def store(env: gym.Env[Any, Any], scenario: Scenario, worlds: Worlds, e: int) -> None:
    """Write one of the simulator's environments, with its random generator, into a live one with the same bodies.

    Raises
    ------
    SceneError
        If the bodies differ from the simulator's.
    """
    base = cast(Any, env.unwrapped)
    vehicles, obstacles = bodies_of(env)
    f, g, p = worlds.f[e], worlds.g[e], worlds.p[e]
    kinds = [*(kind_in_scene(body, i == 0) for i, body in enumerate(vehicles)), *([OBSTACLE] * len(obstacles))]
    if kinds != g[KIND].tolist():
        raise SceneError("the environment has other vehicles than the simulator")
    frames = scenario.rules.numbers[0]
    for i, body in enumerate([*vehicles, *obstacles]):
        body.position = f[[X, Y], i].copy()
        body.heading, body.speed = float(f[HEADING, i]), float(f[SPEED, i])
        body.lane_index = ("0", "1", int(g[LANE, i]))
        body.lane = base.road.network.get_lane(body.lane_index)
        body.crashed, body.check_collisions = bool(g[CRASHED, i]), bool(g[CHECKS, i])
        if i < len(vehicles):
            _store_vehicle(body, f, g, p, i)
    to_generator(worlds.rows[e], base.np_random)
    base.time = float(worlds.clock[e])
    base.steps = round(base.time * base.config["policy_frequency"]) * frames


def _store_vehicle(body: Any, f: FloatArray, g: Any, p: FloatArray, i: int) -> None:
    """Write the controls, targets and parameters of a vehicle in column `i` back into highway-env's object."""
    body.action = {"steering": float(f[STEERING, i]), "acceleration": float(f[ACCELERATION, i])}
    body.impact = f[[IMPACT_X, IMPACT_Y], i].copy() if g[IMPACTED, i] else None
    if isinstance(body, ControlledVehicle):
        body.target_lane_index, body.target_speed = ("0", "1", int(g[TARGET, i])), float(f[TARGET_SPEED, i])
    if isinstance(body, MDPVehicle):
        body.speed_index = body.speed_to_index(body.target_speed)
    if hasattr(body, "timer"):
        body.timer, body.enable_lane_change = float(f[TIMER, i]), bool(g[CHANGES, i])
        body.DELTA = float(p[DELTA, i])
        if hasattr(body, "ACCELERATION_PARAMETERS"):
            body.ACCELERATION_PARAMETERS = p[A_SPEED:S_HEADING, i].copy()
            body.STEERING_PARAMETERS = p[S_HEADING:, i].copy()
