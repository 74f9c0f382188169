"""The other vehicles of a course: where they begin, where they go, and how they come back."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.road.lane import StraightLane
from highway_env.utils import class_from_path
from highway_env.vehicle.behavior import IDMVehicle

from evaluation.scenarios.course import Course
from shield.errors import ConfigError

__all__ = ["ENTRY", "Place", "begin_on", "free_places", "populate", "recycle"]

ENTRY = 10.0
"""Where vehicles begin on a road that leads into the course [m]."""
_LEAVING = 30.0
"""This far before its end a vehicle has left an exit road [m]."""
_STILL = 0.1
"""A wreck that is slower than this is taken away [m/s]."""
_SPACING = 25.0
"""Between two vehicles at first, along a lane and from the ego [m]."""
_PACE = (0.7, 1.0)
"""Speeds at first, in parts of the limit."""

Place = tuple[tuple[str, str, int], float]
"""A lane of the network and a way along it [m]."""


def populate(road: Any, course: Course, kind: str, count: int, ego: Any) -> None:
    """Put `count` vehicles on the course, each with a route to an exit.

    Parameters
    ----------
    road : highway-env's, whose `np_random` draws places, speeds and exits.
    course : the network of it.
    kind : dotted path of `IDMVehicle` or a subclass.
    count : how many.
    ego : who is there already.

    Raises
    ------
    ConfigError
        If the course has no room for so many, or the class is none of highway-env's IDM vehicles.
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


def free_places(course: Course) -> list[Place]:
    """Places for vehicles on the straight roads, at least `_SPACING` apart along a lane; none on roads that only lead
    out."""
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


def recycle(road: Any, course: Course, ego: Any) -> None:
    """Let each vehicle that has come to an exit, and each wreck that stands still, enter again, on a new route.

    It is the same object, so that who records the vehicles of an episode goes on seeing all of them. Where there is no
    room it waits.
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
    """Put a vehicle on the middle of a lane, at its speed limit and with a route to an exit."""
    lane = vehicle.road.network.get_lane(lane_index)
    vehicle.position = np.array(lane.position(along, 0.0), float)
    vehicle.crashed, vehicle.impact = False, None
    vehicle.heading, vehicle.speed = float(lane.heading_at(along)), float(lane.speed_limit)
    vehicle.lane_index, vehicle.lane = lane_index, lane
    vehicle.target_lane_index, vehicle.target_speed = lane_index, float(lane.speed_limit)
    vehicle.plan_route_to(destination)


def _some_exit(road: Any, course: Course) -> str:
    exits = list(course.exits)
    return exits[int(road.np_random.integers(len(exits)))]


def _apart(course: Course, place: Place, position: Any) -> bool:
    lane, along = course.network.get_lane(place[0]), place[1]
    return bool(np.hypot(*(lane.position(along, 0.0) - position)) > _SPACING)
