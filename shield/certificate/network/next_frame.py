"""Who collides with the ego in the coming frame, as highway-env counts collisions: both keep their velocities.

highway-env counts it as a crash where two bodies that go straight on along their headings would touch before the next
frame (`are_polygons_intersecting`), however they drive then. What is foreseen of a vehicle goes along its lanes. So a
body that stays in its band, and points out of it, makes the ego crash without having come nearer.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.compiled import uncounted
from dynamics.state import FloatArray, IntArray
from dynamics.traffic.rules_of_the_road import Ego, gap_between
from shield.certificate.network.others import Traffic

__all__ = ["collisions"]


@uncounted
def _fill_gaps(ego: Ego, rows: FloatArray, dt: float, out: FloatArray) -> None:
    """The gap of the ego's body from each vehicle, rows (m, 7), where both keep their velocity for `dt`, (m,) [m]."""
    for i in range(len(rows)):
        out[i] = gap_between(ego, ego.body_along, ego.body_across, rows, i, dt)


def _gaps(ego: Ego, rows: FloatArray, dt: float) -> FloatArray:
    out = np.empty(len(rows))
    _fill_gaps(ego, rows, dt, out)
    return out


def collisions(base: Any, seen: Traffic, marks: IntArray, names: list[tuple[str, str, int]]) -> dict[Any, bool]:
    """The vehicles that collide with the ego's body in the coming frame of an environment, unwrapped; and whether that
    is for their heading: pointing along any of the lanes that they are on, they would not.

    Parameters
    ----------
    marks : of the vehicles' strips, see `dynamics.road_networks.reachable.strips.Strips`.
    names : highway-env's indices of the lanes.
    """
    vehicle, dt, found = base.vehicle, 1 / base.config["simulation_frequency"], {}
    x, y, heading, speed = map(float, (*vehicle.position, vehicle.heading, vehicle.speed))
    half = 0.5 * vehicle.LENGTH, 0.5 * vehicle.WIDTH
    ego = Ego(x, y, heading, speed, *half, *half, False)
    for i in np.flatnonzero(_gaps(ego, seen.rows, dt) <= 0.0):
        lanes = [base.road.network.get_lane(names[k]) for k in marks[(marks[:, 0] == i) & (marks[:, 2] == -1), 1]]
        turned = np.repeat(seen.rows[i : i + 1], len(lanes), axis=0)
        for one, lane in zip(turned, lanes, strict=True):
            one[2] = lane.heading_at(np.clip(lane.local_coordinates(one[:2])[0], 0.0, lane.length))
        found[seen.who[i]] = bool((_gaps(ego, turned, dt) > 0.0).all())
    return found
