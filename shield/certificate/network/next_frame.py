"""Collisions with the ego in the coming frame as highway-env counts them: with both velocities constant.

highway-env counts a crash where two bodies that moved straight on along their headings would touch before the next
frame (`are_polygons_intersecting`). Their actual motion does not matter. The prediction of a vehicle follows its lanes
instead. So a vehicle that stays in its band, with a heading out of the band, causes a crash without coming nearer.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.compiled import kernel_no_refcount
from dynamics.state import FloatArray, IntArray
from dynamics.traffic.rules_of_the_road import EgoFootprint, gap_between
from shield.certificate.network.others import TrafficRows

__all__ = ["collisions"]


@kernel_no_refcount
def _fill_gaps(ego: EgoFootprint, rows: FloatArray, dt: float, out: FloatArray) -> None:
    """Write the gap between the ego's body and each vehicle, rows (m, 7), with both velocities constant for `dt` [s],
    to `out`, (m,) [m]."""
    for i in range(len(rows)):
        out[i] = gap_between(ego, ego.body_along, ego.body_across, rows, i, dt)


def _gaps(ego: EgoFootprint, rows: FloatArray, dt: float) -> FloatArray:
    """The gaps of `_fill_gaps`, (m,) [m]."""
    out = np.empty(len(rows))
    _fill_gaps(ego, rows, dt, out)
    return out


def collisions(base: Any, seen: TrafficRows, marks: IntArray, names: list[tuple[str, str, int]]) -> dict[Any, bool]:
    """The vehicles that collide with the ego's body in the coming frame, in an unwrapped environment. The value is
    whether the heading causes the collision: with the direction of any of its lanes, the vehicle would not collide.

    Parameters
    ----------
    seen : the other vehicles.
    marks : of their reachable intervals, (k, 3), see `dynamics.road_networks.reachable.strips.Strips`.
    names : highway-env's indices of the lanes.
    """
    vehicle, dt, found = base.vehicle, 1 / base.config["simulation_frequency"], {}
    x, y, heading, speed = map(float, (*vehicle.position, vehicle.heading, vehicle.speed))
    half = 0.5 * vehicle.LENGTH, 0.5 * vehicle.WIDTH
    ego = EgoFootprint(x, y, heading, speed, *half, *half, False)
    for i in np.flatnonzero(_gaps(ego, seen.rows, dt) <= 0.0):
        lanes = [base.road.network.get_lane(names[k]) for k in marks[(marks[:, 0] == i) & (marks[:, 2] == -1), 1]]
        turned = np.repeat(seen.rows[i : i + 1], len(lanes), axis=0)
        for one, lane in zip(turned, lanes, strict=True):
            one[2] = lane.heading_at(np.clip(lane.local_coordinates(one[:2])[0], 0.0, lane.length))
        found[seen.identities[i]] = bool((_gaps(ego, turned, dt) > 0.0).all())
    return found
