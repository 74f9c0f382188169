"""Inputs of the predictive filter from a scene: rectangles, edges and curvature of its stages."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.roads.straight import Road
from dynamics.scenes.scene import Scene
from dynamics.state import FloatArray, RoadState
from dynamics.traffic.occupancy import OtherVehicles
from mpc.filter.problem import FilterSettings

__all__ = ["curvature_ahead", "edges_of", "rectangles"]


def rectangles(around: OtherVehicles, rows: Any, settings: FilterSettings) -> FloatArray:
    """Reachable rectangles of the vehicles `rows` at each stage's end, (N, len(rows), 4), columns `Occupied` [m]."""
    ends = np.array(settings.ends) - 1
    seen = around.occupancy(settings.ends[-1])
    boxes = np.empty((settings.stages, len(rows), 4))
    boxes[..., 0], boxes[..., 1] = seen.rear[np.ix_(rows, ends)].T, seen.front[np.ix_(rows, ends)].T
    boxes[..., 2], boxes[..., 3] = seen.low[rows], seen.high[rows]
    return boxes


def edges_of(road: Road, lanes: list[int], r: float, side: float) -> tuple[float, float]:
    """Least and greatest r [m] of a body that drives in these lanes: their outer edges.

    In an unfinished lane change the body may still use its former lane. So a body with half width `side` [m] at r is
    always within the result.
    """
    centers = road.centers[lanes]
    low, high = float(centers.min()) - 0.5 * road.width, float(centers.max()) + 0.5 * road.width
    return min(low, r - side), max(high, r + side)


def curvature_ahead(scene: Scene, speed: float, settings: FilterSettings) -> FloatArray | None:
    """Curvature of the road at the start of each stage at that speed, (N,) [1/m]; None on a straight road."""
    if scene.road.bends is None:
        return None
    begins = np.array(settings.ends) - settings.frames
    s = float(scene.ego_road[RoadState.S]) + speed * settings.dt * begins
    return np.asarray(scene.road.curvature(s))
