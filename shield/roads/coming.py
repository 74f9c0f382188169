"""Who collides with the ego in the coming frame, as highway-env counts collisions: both keep their velocities.

highway-env counts it as a crash where two bodies that go straight on along their headings would touch before the next
frame (`are_polygons_intersecting`), however they drive then. What is foreseen of a vehicle goes along its lanes. So a
body that stays in its band, and points out of it, makes the ego crash without having come nearer.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.state import FloatArray, IntArray
from shield.roads.reading import Traffic

__all__ = ["collisions"]


def collisions(base: Any, seen: Traffic, marks: IntArray, names: list[tuple[str, str, int]]) -> dict[Any, bool]:
    """The vehicles that collide with the ego's body in the coming frame of an environment, unwrapped; and whether that
    is for their heading: pointing along any of the lanes that they are on, they would not.

    Parameters
    ----------
    marks : of the vehicles' strips, see `dynamics.networks.reachable.strips.Strips`.
    names : highway-env's indices of the lanes.
    """
    ego, dt, found = base.vehicle, 1 / base.config["simulation_frequency"], {}
    row = np.array([*ego.position, ego.heading, ego.speed, ego.LENGTH, ego.WIDTH], float)
    for i in np.flatnonzero(_coming_gaps(row, seen.rows, dt) <= 0.0):
        lanes = [base.road.network.get_lane(names[k]) for k in marks[(marks[:, 0] == i) & (marks[:, 2] == -1), 1]]
        turned = np.repeat(seen.rows[i : i + 1], len(lanes), axis=0)
        for one, lane in zip(turned, lanes, strict=True):
            one[2] = lane.heading_at(np.clip(lane.local_coordinates(one[:2])[0], 0.0, lane.length))
        found[seen.who[i]] = bool((_coming_gaps(row, turned, dt) > 0.0).all())
    return found


def _coming_gaps(ego: FloatArray, rows: FloatArray, dt: float) -> FloatArray:
    """The gap of each vehicle, rows (m, 6 or more), from another, (6,), where both keep their velocity for `dt`, (m,)
    [m]; notation as in `dynamics.scenes.rectangles`."""
    d = ego[:2] - rows[:, :2]
    u, w = np.array([np.cos(ego[2]), np.sin(ego[2])]), np.stack([np.cos(rows[:, 2]), np.sin(rows[:, 2])], axis=-1)
    half = 0.5 * dt * (ego[3] * u - rows[:, 3:4] * w)
    c, s = np.abs(w @ u), np.abs(w @ np.array([-u[1], u[0]]))
    (a, b), (length, width) = 0.5 * ego[4:6], 0.5 * rows[:, 4:6].T
    gaps = []
    for axis, reach in (
        (u, a + length * c + width * s),
        (np.array([-u[1], u[0]]), b + length * s + width * c),
        (w, length + a * c + b * s),
        (np.stack([-w[:, 1], w[:, 0]], axis=-1), width + a * s + b * c),
    ):
        way = (half * axis).sum(axis=-1)
        gaps.append(np.abs((d * axis).sum(axis=-1) + way) - np.abs(way) - reach)
    most: FloatArray = np.max(gaps, axis=0)
    return most
