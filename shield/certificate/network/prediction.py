"""The road of an episode as the certificate reads it, and the prediction of every place that the other vehicles can
reach."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from highway_env.road.lane import CircularLane

from dynamics.errors import SceneError
from dynamics.highway_simulator.layout import LANE_LENGTH
from dynamics.road_networks.geometry.lanes import NetworkLanes
from dynamics.road_networks.geometry.layout import PRIORITY
from dynamics.road_networks.geometry.network import index_of
from dynamics.road_networks.geometry.points import circles_of
from dynamics.road_networks.reachable.continuations import (
    bends_before_of,
    continuations_of,
    leads_off_of,
    leads_over,
    overruns_of,
)
from dynamics.road_networks.reachable.prediction import add_all_strips, distance_bounds
from dynamics.road_networks.reachable.rights import right_of_way_by_lane, right_of_way_by_strip
from dynamics.road_networks.reachable.strips import (
    BODY_HALF,
    HIGH,
    LOW,
    NEAR,
    START,
    DrivingBounds,
    LaneContinuations,
    empty_strips,
)
from dynamics.road_networks.simulation.ego_manoeuvres import EgoOnNetwork
from dynamics.state import FloatArray, IntArray, Vehicle
from shield.certificate.network.lateral_gap import greatest_curvature
from shield.certificate.network.monitor import NetworkObservation
from shield.certificate.network.next_frame import collisions
from shield.certificate.network.obligations import RightOfWayObligations
from shield.certificate.network.others import read_traffic
from shield.certificate.network.workspace import EgoExtents, NetworkContext, NetworkFollowerResponse, NetworkVehicles
from shield.config import ShieldConfig

__all__ = ["LARGEST_ARC", "NetworkPredictor", "network_context"]

LARGEST_ARC = 5.0
"""Greatest angle of a lane that is an arc [rad]."""
_STRIPS = 1024
"""Initial capacity, in reachable intervals."""
_BENT = 1.0
"""Bound on how much further the ego may reach in s and r than in metres, on a curved lane [m]."""


def network_context(base: Any, alone: EgoOnNetwork, config: ShieldConfig) -> NetworkContext:
    """Lanes, assumptions and extents of the ego, for an unwrapped environment.

    Raises
    ------
    SceneError
        If a lane is an arc of more than `LARGEST_ARC`.
    """
    _refuse_long_arcs(base.road.network)
    a, buffer, frequency = config.assumptions, config.buffer, base.config["simulation_frequency"]
    network, machine = alone.rules.network, alone.machine
    lanes = NetworkLanes(machine.sums, machine.loops, network.lanes, network.ids, network.near)
    after, ends, entries = continuations_of(base.road.network)
    over, overruns = leads_over(base.road.network), overruns_of(base.road.network, after, entries)
    leads_off = leads_off_of(base.road.network, after, a.max_speed / frequency)
    bends: Any = greatest_curvature
    before = bends_before_of(after, np.array([bends.py_func(lanes, lane) for lane in range(len(network.lanes))]))
    ways = LaneContinuations(after, ends, entries, over, overruns, leads_off, before)
    circles = np.zeros((len(network.lanes), 3))
    circles_of(lanes, circles)
    length, width = base.vehicle.LENGTH / 2, base.vehicle.WIDTH / 2
    return NetworkContext(
        lanes=lanes,
        circles=circles,
        rights=right_of_way_by_lane(network.ids[:, PRIORITY], ways),
        ways=ways,
        bounds=DrivingBounds(a.braking, a.acceleration, a.max_speed, a.lateral_deviation, a.marking_tolerance),
        response=NetworkFollowerResponse(
            a.follower_braking, math.ceil(a.reaction_time * frequency - 1e-9), a.considers_connected_lanes, a.gives_way
        ),
        body=EgoExtents(length, width, length + buffer.longitudinal, width + buffer.lateral, a.visible_distance),
        period=1 / frequency,
    )


def _refuse_long_arcs(network: Any) -> None:
    """Raise `SceneError` if a lane is an arc of more than `LARGEST_ARC`."""
    for (a, b, k), lane in zip(index_of(network), network.lanes_list(), strict=True):
        turn = lane.length / lane.radius if isinstance(lane, CircularLane) else 0.0
        if turn > LARGEST_ARC:
            raise SceneError(
                f"lane {(a, b, k)} is an arc of {math.degrees(turn):.0f} degrees; without simulation at most "
                f"{math.degrees(LARGEST_ARC):.0f} are accepted, because a body at its start can reach across its end: "
                "divide it into two lanes, or pass ShieldConfig.simulated_traffic()"
            )


def _rooms(marks: IntArray, numbers: FloatArray, lengths: FloatArray, beyond_ends: FloatArray) -> FloatArray:
    """`NetworkVehicles.rooms` of reachable intervals, on lanes of these `lengths` [m].

    They cover all that the intervals may overlap, so that the judgement of one vehicle does not depend on the other
    vehicles present. `beyond_ends`: how far straight motion leads past the end of the lane of each interval, (k,) [m].
    """
    lanes, rooms = marks[:, 1], np.zeros(len(lengths))
    beyond = np.maximum(-numbers[:, START], -numbers[:, NEAR] - lengths[lanes])
    along = numbers[:, BODY_HALF] + np.maximum(beyond, 0.0) + beyond_ends
    np.maximum.at(rooms, lanes, np.max([along, numbers[:, HIGH], -numbers[:, LOW]], axis=0) + _BENT)
    return rooms


class NetworkPredictor:
    """Predicts the other vehicles on one road, scene after scene.

    Parameters
    ----------
    base : the environment, unwrapped. alone, road : its road, see `network_context`. frames : horizon of the
        prediction.
    """

    def __init__(self, base: Any, alone: EgoOnNetwork, road: NetworkContext, frames: int) -> None:
        self._base, self._network, self._road, self._frames = base, alone.rules.network, road, frames
        self._index = index_of(base.road.network)
        self._names = list(self._index)
        self._strips = empty_strips(_STRIPS)

    def predict(self, obligations: RightOfWayObligations) -> NetworkObservation:
        """The other vehicles now, and where they can be. `obligations` are their obligations towards the ego."""
        seen, road = read_traffic(self._base, self._network, self._index), self._road
        drive = np.zeros((len(seen.rows), 5))
        while True:
            strips = self._strips
            given = seen.rows, seen.own, seen.routes
            count = add_all_strips(road.lanes, road.ways, road.bounds, *given, strips, drive)
            if count <= len(strips.marks):
                break
            self._strips = empty_strips(2 * len(strips.marks))
        marks, numbers = strips.marks[:count].copy(), strips.numbers[:count].copy()
        least, most = np.zeros((2, len(seen.rows), self._frames + 3))
        distance_bounds(road.bounds, seen.rows, drive, road.period, least, most)
        ways = np.maximum(np.maximum(drive[:, 0], seen.rows[:, Vehicle.SPEED]), 0.0) * road.period
        beyond_ends = np.where(road.ways.leads_off[marks[:, 1]], ways[marks[:, 0]], 0.0)
        obliged, gives = obligations.tables(seen.identities, len(road.circles))
        ranks = np.zeros(count, np.int64)
        if road.response.gives_way:
            right_of_way_by_strip(road.ways, road.rights, marks, ranks)
        others = NetworkVehicles(
            rows=seen.rows,
            things=seen.things,
            marks=marks,
            numbers=numbers,
            found=np.array([count]),
            drive=drive,
            least=least,
            most=most,
            obliged=obliged,
            offends=np.zeros(len(seen.rows), dtype=bool),
            gives=gives,
            ranks=ranks,
            waits=np.zeros(count, dtype=bool),
            shut=np.zeros(count, dtype=bool),
            lanes=np.unique(marks[:, 1]),
            rooms=_rooms(marks, numbers, road.lanes.rows[:, LANE_LENGTH], beyond_ends),
        )
        colliding = collisions(self._base, seen, marks, self._names)
        return NetworkObservation(seen.identities, others, seen.stand, seen.unreadable, colliding)
