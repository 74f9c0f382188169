"""Scenes placed by hand on highway-env's networks of roads, behind a shield."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import gymnasium as gym
import highway_env  # noqa: F401
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import MDPVehicle

from shield import ShieldConfig, ShieldedEnv

__all__ = ["SHIELDS", "Body", "placed", "shielded"]

SHIELDS = {"exact": ShieldConfig.simulated_traffic(), "worst case": "worst-case"}
"""Settings of simulated traffic, and of the worst case."""
_LASTS = 1_000
"""No episode is over for its length [s, decisions]."""


class Body(NamedTuple):
    """A vehicle on its way.

    Attributes
    ----------
    lane : highway-env's index. s, r : along and across it [m]. speed : what it drives and wants to [m/s].
    to : the node that its route ends at. turned : its heading, from the lane's [rad].
    """

    lane: tuple[str, str, int]
    s: float
    speed: float
    to: str
    r: float = 0.0
    turned: float = 0.0


@cache
def shielded(env_id, settings, speeds=None, **config):
    """An environment whose episodes last, without new vehicles at intersections, with one of `SHIELDS`; cached.

    `speeds` are the ego's target speeds [m/s], a tuple; the environment's own by default.
    """
    finite = {"spawn_probability": 0.0} if "intersection" in env_id else {}
    if speeds is not None:
        finite["action"] = {"type": "DiscreteMetaAction", "target_speeds": list(speeds)}
    made = gym.make(env_id, config={"duration": _LASTS, **finite, **config}, max_episode_steps=_LASTS)
    return ShieldedEnv(made, SHIELDS[settings])


def placed(env_id, settings, ego, others=(), driver=IDMVehicle, speeds=None):
    """`shielded`, reset, with these bodies alone; `driver` is the class of the other vehicles."""
    env = shielded(env_id, settings, speeds, **({"initial_vehicle_count": 1} if "intersection" in env_id else {}))
    env.reset(seed=0)
    road = env.unwrapped.road
    road.vehicles, road.objects = [_put(env.unwrapped.vehicle, ego)], []
    for each in others:
        road.vehicles.append(_put(driver(road, road.network.get_lane(each.lane).position(each.s, each.r)), each))
    env.filter.reset()
    return env


def _put(vehicle, body):
    lane = vehicle.road.network.get_lane(body.lane)
    vehicle.position, vehicle.heading = lane.position(body.s, body.r), lane.heading_at(body.s) + body.turned
    vehicle.speed, vehicle.lane, vehicle.lane_index, vehicle.target_lane_index = body.speed, lane, body.lane, body.lane
    vehicle.target_speed = body.speed
    if isinstance(vehicle, IDMVehicle):
        # highway-env makes it of where in the world the vehicle is.
        vehicle.timer = 0.0
    elif isinstance(vehicle, MDPVehicle):
        vehicle.speed_index = vehicle.speed_to_index(body.speed)
        vehicle.target_speed = vehicle.index_to_speed(vehicle.speed_index)
    return vehicle.plan_route_to(body.to)
