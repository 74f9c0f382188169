"""Reachable areas of other vehicles in the frame in which a refused proposal has its shortfall, as world outlines.

Each certificate repeats its prediction from the decision's source. The areas are reachable rectangles on a straight or
curved road, reachable lane intervals on a network, and the bodies themselves in simulated traffic.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import shapely

from dynamics.road_networks.geometry.road_geometry import RoadGeometry
from dynamics.roads.straight import StraightRoad
from dynamics.state import RoadState, State, Vehicle
from evaluation.measuring.rectangles import polygons
from evaluation.replay.record import ReplayArea, rounded
from evaluation.report.reachable_areas import interval_outline
from shield.certificate.network.workspace import NetworkPrediction
from shield.certificate.road.memory import ObservedScene
from shield.decision import Decision
from shield.explaining.roads import NetworkDecisionData
from shield.explaining.simulated import SimulatedDecisionData
from shield.pipelines.decide import DecisionData

__all__ = ["areas_at"]

BodyColumns = Mapping[Any, int]
"""Number of each body in the replay, by the simulator's object."""
_ASSUMED = 1.0
"""Time ahead that is shown if a refusal has no time [s]."""
_SAMPLE = 2.0
"""Distance of two points of an outline along a curved road [m]."""
_FAR = 200.0
"""Greatest distance of drawn areas from the ego [m]."""


def areas_at(
    refused: Decision,
    after: float,
    dt: float,
    column: BodyColumns,
    foreseen: tuple[RoadGeometry, NetworkPrediction] | None,
) -> list[ReplayArea]:
    """Reachable areas of other vehicles.

    Parameters
    ----------
    refused : the refused decision of the explanation.
    after : time of the shortfall after its frame [s]; NaN means 1 s.
    dt : duration of a frame [s].
    column : number of each body in the replay, by the simulator's object.
    foreseen : on a road network, its geometry and the reachable lane intervals of that frame.
    """
    frames = max(1, round((after if np.isfinite(after) else _ASSUMED) / dt))
    if foreseen is not None and isinstance(refused.source, NetworkDecisionData):
        return _interval_areas(*foreseen, frames, refused.source.identities, column)
    if isinstance(refused.source, DecisionData):
        return _rectangles(refused.source, frames, column)
    if isinstance(refused.source, SimulatedDecisionData):
        return _bodies(refused.source, frames, column)
    return []


def _rectangles(made: DecisionData[Any], frames: int, column: BodyColumns) -> list[ReplayArea]:
    view, _ = made.procedure.observe(made.memory, made.scene)
    if not isinstance(view, ObservedScene):
        return []
    scene, found = view.scene, []
    ego = scene.ego[: State.Y + 1]
    bodies = scene.bodies or [None] * len(scene.others)
    rows = view.verifier.around.occupancy(frames).rectangles()[-1]
    for body, (s_min, s_max, r_min, r_max) in zip(bodies, rows, strict=True):
        if not (s_max > s_min and r_max > r_min):
            continue
        n = 2 if isinstance(scene.road, StraightRoad) else max(2, int((s_max - s_min) / _SAMPLE) + 2)
        s = np.linspace(s_min, s_max, n)
        states = np.zeros((2 * n, 4))
        states[:, RoadState.S] = np.concatenate([s, s[::-1]])
        states[:, RoadState.R] = np.repeat([r_min, r_max], n)
        outline = np.asarray(scene.road.to_world(states))[:, : State.Y + 1]
        if np.hypot(*(outline - ego).T).min() < _FAR:
            found.append(ReplayArea(column.get(body, -1), rounded(outline)))
    return found


def _interval_areas(
    geometry: RoadGeometry, foreseen: NetworkPrediction, frames: int, identities: Sequence[Any], column: BodyColumns
) -> list[ReplayArea]:
    frame = min(frames, foreseen.most.shape[1] - 1)
    outlines = [interval_outline(geometry, foreseen, j, frame, frame) for j in range(len(foreseen.lanes))]
    return [
        ReplayArea(column.get(identities[int(vehicle)], -1), rounded(outline))
        for vehicle, outline in zip(foreseen.vehicles, outlines, strict=True)
        if outline is not None
    ]


def _bodies(source: SimulatedDecisionData, frames: int, column: BodyColumns) -> list[ReplayArea]:
    rows, ego = source.predicted()
    if not len(rows):
        return []
    row = rows[min(frames, len(rows) - 1)]
    there = [k for k in range(len(row)) if k != ego and row[k, Vehicle.LENGTH] > 0]
    return [
        ReplayArea(column.get(source.identities[k], -1), rounded(shapely.get_coordinates(polygons(row[k]))[:-1]))
        for k in there
    ]
