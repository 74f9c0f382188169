"""Other vehicles of a map: initial positions, routes, and re-entry."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.road.lane import StraightLane
from highway_env.utils import class_from_path
from highway_env.vehicle.behavior import IDMVehicle

from evaluation.scenarios.course import ScenarioMap
from shield.errors import ConfigError

__all__ = ["ENTRY", "LanePosition", "begin_on", "free_places", "populate", "recycle"]

ENTRY = 10.0
"""Initial position on a road that leads into the map [m]."""
_LEAVING = 30.0
"""Distance to the end of an exit road at which a vehicle has left the map [m]."""
_STILL = 0.1
"""Speed below which a wreck is removed [m/s]."""
_SPACING = 25.0
"""Least initial distance of two vehicles, along a lane and from the ego [m]."""
_PACE = (0.7, 1.0)
"""Range of initial speeds, as a share of the speed limit."""

LanePosition = tuple[tuple[str, str, int], float]
"""A lane of the network and a position along it [m]."""


def populate(road: Any, course: ScenarioMap, kind: str, count: int, ego: Any) -> None:
    """Put `count` vehicles on the map, each with a route to an exit.

    Parameters
    ----------
    road : highway-env's road; its `np_random` draws positions, speeds and exits.
    course : the map of the road.
    kind : dotted path of `IDMVehicle` or a subclass.
    count : number of vehicles.
    ego : the ego, which is on the road already.

    Raises
    ------
    ConfigError
        If the map has too little room, or the class is no subclass of `IDMVehicle`.
    """
    vehicle_class = class_from_path(kind)
    if not issubclass(vehicle_class, IDMVehicle):
        raise ConfigError(f"other_vehicles_type {kind} drives no route by itself; have subclasses of IDMVehicle")
    places = [place for place in free_places(course) if _apart(course, place, ego.position)]
    if count > len(places):
        raise ConfigError(f"vehicle_density {count} is more than the {len(places)} vehicles that have room here")
    for i in road.np_random.permutation(len(places))[:count]:
        (start, end, lane), along = places[i]
        limit = road.network.get_lane((start, end, lane)).speed_limit
        speed = limit * float(road.np_random.uniform(*_PACE))
        vehicle = vehicle_class.make_on_lane(road, (start, end, lane), along, speed)
        vehicle.target_speed = limit
        vehicle.randomize_behavior()
        vehicle.plan_route_to(_some_exit(road, course))
        road.vehicles.append(vehicle)


def free_places(course: ScenarioMap) -> list[LanePosition]:
    """Positions for vehicles on straight roads, at least `_SPACING` apart along a lane, without exit roads."""
    leading_out = set(course.exits.values())
    return [
        ((edge.start, edge.end, i), float(along))
        for piece in course.pieces
        for edge in piece.edges
        if (edge.start, edge.end) not in leading_out
        for i, lane in enumerate(edge.lanes)
        if type(lane) is StraightLane
        for along in np.arange(ENTRY, lane.length - ENTRY, _SPACING)
        if lane.length > _SPACING + ENTRY
    ]


def recycle(road: Any, course: ScenarioMap, ego: Any) -> None:
    """Let vehicles at an exit, and wrecks at rest, enter again on a new route.

    The vehicle object stays the same, so that recorders of the episode keep track of it. Without room it waits.
    """
    ends = set(course.exits.values())
    for vehicle in road.vehicles:
        if vehicle is ego or not _is_over(vehicle, ends):
            continue
        others = [other.position for other in road.vehicles if other is not vehicle]
        places = [(start, end, i) for start, end in course.spawns for i in range(len(road.network.graph[start][end]))]
        places = [place for place in places if all(_apart(course, (place, ENTRY), other) for other in others)]
        if places:
            begin_on(vehicle, places[int(road.np_random.integers(len(places)))], ENTRY, _some_exit(road, course))
        else:
            vehicle.target_speed = 0.0


def _is_over(vehicle: Any, ends: set[tuple[str, str]]) -> bool:
    if vehicle.crashed:
        return bool(abs(vehicle.speed) < _STILL)
    left = vehicle.lane.length - vehicle.lane.local_coordinates(vehicle.position)[0]
    return bool(vehicle.lane_index[:2] in ends and left <= _LEAVING)


def begin_on(vehicle: Any, lane_index: tuple[str, str, int], along: float, destination: str) -> None:
    """Put a vehicle on the centre line of a lane, at the speed limit and with a route to an exit."""
    lane = vehicle.road.network.get_lane(lane_index)
    vehicle.position = np.array(lane.position(along, 0.0), float)
    vehicle.crashed, vehicle.impact = False, None
    vehicle.heading, vehicle.speed = float(lane.heading_at(along)), float(lane.speed_limit)
    vehicle.lane_index, vehicle.lane = lane_index, lane
    vehicle.target_lane_index, vehicle.target_speed = lane_index, float(lane.speed_limit)
    vehicle.plan_route_to(destination)


def _some_exit(road: Any, course: ScenarioMap) -> str:
    exits = list(course.exits)
    return exits[int(road.np_random.integers(len(exits)))]


def _apart(course: ScenarioMap, place: LanePosition, position: Any) -> bool:
    lane, along = course.network.get_lane(place[0]), place[1]
    return bool(np.hypot(*(lane.position(along, 0.0) - position)) > _SPACING)
