"""Bounds on what is seen through a sensor that is not exact, no wider than what was known before leaves room for.

Where a scene's rows are bounds and not states, the next sensor reading may put a body a little nearer than the last
plan was verified against, by nothing but noise. But that body has moved by the assumptions: ahead of the ego, its rear
is no further back, and it is no slower, than the worst case of the scene before said of this one; behind, its front is
no further ahead, and it is no faster. What is known is what both say (set-membership estimation, Schweppe 1968), so
that a plan that was verified stays so.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynamics.scenes.scene import Scene
from dynamics.state import IntArray, RoadState, Vehicle
from dynamics.traffic.occupancy import Surroundings

__all__ = ["nested"]

_S, _V = int(RoadState.S), int(RoadState.SPEED)


def nested(last: Scene, around: Surroundings, same: IntArray, scene: Scene) -> Scene:
    """A scene a frame later, with bounds that are no wider than what `last` and its surroundings leave.

    Parameters
    ----------
    same : which of the others in the last scene each is, (m,); -1 for newcomers.
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
    # What is not known of the far end of a body makes no difference to the ego.
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
