"""Shrinks the bounds from an inexact sensor to what the scene before leaves possible.

The rows of a scene may be bounds instead of states. Then noise alone may put a vehicle nearer in the next reading than
the last plan was verified against. But the vehicle has moved within the assumptions. Ahead of the ego, its rear is no
further back, and its speed no lower, than the worst case of the scene before. Behind the ego, its front is no further
ahead, and its speed no higher. Both bounds hold, so their intersection does (set-membership estimation, Schweppe 1968).
With it, a plan that was verified stays verified.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynamics.scenes.scene import Scene
from dynamics.state import IntArray, RoadState, Vehicle
from dynamics.traffic.occupancy import OtherVehicles

__all__ = ["shrink_bounds"]

_S, _V = int(RoadState.S), int(RoadState.SPEED)


def shrink_bounds(last: Scene, around: OtherVehicles, same: IntArray, scene: Scene) -> Scene:
    """A scene a frame later, with bounds no wider than `last` and its surroundings permit.

    Parameters
    ----------
    last : the scene before. around : its surroundings.
    same : index of each vehicle in the last scene, (m,); -1 for new ones. scene : the new scene.
    """
    known = np.flatnonzero(same >= 0)
    if not known.size:
        return scene
    before, states, rows = same[known], scene.others_road, scene.others.copy()
    ego, ego_before = float(scene.ego_road[_S]), float(last.ego_road[_S])
    half = 0.5 * rows[known, Vehicle.LENGTH]
    place, speed, speed_before = states[known, _S].copy(), states[known, _V].copy(), last.others_road[before, _V]
    ahead = (place > ego) & (last.others_road[before, _S] > ego_before)
    behind = (place < ego) & (last.others_road[before, _S] < ego_before)
    # The uncertainty of the far end of a body does not matter to the ego.
    rear, slowest = around.rear(1)[before, 0], speed_before - around.tables.brakes[before, 0] * scene.dt
    front, fastest = around.front(1)[before, 0], speed_before + around.assumptions.acceleration * scene.dt
    place[ahead] = np.maximum(place, rear + half)[ahead]
    speed[ahead] = np.maximum(speed, slowest)[ahead]
    place[behind] = np.minimum(place, front - half)[behind]
    speed[behind] = np.minimum(speed, fastest)[behind]
    road = states[known].copy()
    road[:, _S], road[:, _V] = place, speed
    rows[known, : len(RoadState)] = scene.road.to_world(road)
    return replace(scene, others=rows)
