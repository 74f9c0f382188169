"""What a car on a curved road needs beyond a straight road's rectangle, from its true corners."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.roads.footprint import bend_growth
from dynamics.roads.path import PathRoad
from dynamics.state import FloatArray, RoadState, State

_CORNERS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
_BESIDE = np.linspace(-1.0, 1.0, 5)


def road_growth(road: PathRoad, states: FloatArray, length: Any, width: Any) -> tuple[FloatArray, FloatArray]:
    """`bend_growth` of cars anywhere on a road, its joints included.

    Parameters
    ----------
    states : road states, shape (..., 4).
    length, width : of the cars [m], broadcastable to (...).

    Returns
    -------
    Extra half extents along and across [m], shape (...). Along, it is the least that is enough: lines s = constant
    are straight, so the greatest and the least s of a convex car are at its corners. Across, it is the greatest over
    the curvatures of the path beside the car (of pieces longer than a quarter of its diagonal): the path lies
    between the arcs of greatest and least curvature through the point at s, so each distance does too.
    """
    length, width = (np.broadcast_to(np.asarray(value, dtype=float), states.shape[:-1]) for value in (length, width))
    s, r, psi = (states[..., i] for i in (RoadState.S, RoadState.R, RoadState.HEADING))
    world = road.to_world(states)
    a, b = length[..., None] / 2 * _CORNERS[:, 0], width[..., None] / 2 * _CORNERS[:, 1]
    cos, sin = np.cos(world[..., State.HEADING, None]), np.sin(world[..., State.HEADING, None])
    corners = np.zeros((*a.shape, 4))
    corners[..., State.X] = world[..., State.X, None] + a * cos - b * sin
    corners[..., State.Y] = world[..., State.Y, None] + a * sin + b * cos
    reached = np.abs(road.to_road(corners, near=s[..., None])[..., RoadState.S] - s[..., None])
    h_along = length / 2 * np.abs(np.cos(psi)) + width / 2 * np.abs(np.sin(psi))
    farthest = reached.max(axis=-1)
    beside = road.curvature(s[..., None] + farthest[..., None] * _BESIDE)
    _, across = bend_growth(length[..., None], width[..., None], psi[..., None], r[..., None], beside)
    return np.maximum(farthest - h_along, 0.0), across.max(axis=-1)
