"""In which order alternatives are tried: the policy's own where it has one, else a documented default."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dynamics.scenes.scene import Scene, Target
from dynamics.state import RoadState, Vehicle

__all__ = ["CLEAR", "GAIN", "IN_LANE", "OUTLOOK", "Order", "default_order", "lane_progress", "resolve"]

Order = Sequence[int] | Callable[[], Sequence[int] | None] | None
"""Alternatives in order of preference, or a function that is asked only when an override is due."""

IN_LANE = 0.625
"""Distance from a lane's centre within which a vehicle counts as in it, in widths of a lane."""
OUTLOOK = 3.0
"""Weight of a leader's relative speed against its distance [s]."""
CLEAR = 1000.0
"""Progress of a lane with nobody ahead [m]."""
GAIN = 5.0
"""Least progress by which another lane must be better than the ego's before it is preferred [m]."""


def lane_progress(scene: Scene, lane: int) -> float:
    """How much room a lane offers: distance to the first vehicle ahead plus 3 s of its relative speed [m]."""
    return _room(scene, lane)[0]


def _room(scene: Scene, lane: int) -> tuple[float, float]:
    """The progress of a lane, and by how much it may be off [m]: bodies seen through noise reach as far as they may."""
    states, ego = scene.others_road, scene.ego_road
    ahead = (np.abs(states[:, RoadState.R] - scene.road.centers[lane]) < IN_LANE * scene.road.width) & (
        states[:, RoadState.S] > ego[RoadState.S]
    )
    if not ahead.any():
        return CLEAR, 0.0
    room = states[ahead, RoadState.S] - ego[RoadState.S]
    j = int(room.argmin())
    progress = float(room[j] + OUTLOOK * (states[ahead, RoadState.SPEED][j] - ego[RoadState.SPEED]))
    if not scene.blurred:
        return progress, 0.0
    return progress, max(0.0, float(scene.others[ahead, Vehicle.LENGTH][j] - scene.ego[Vehicle.LENGTH]) / 2)


def default_order(scene: Scene, proposed: int, targets: list[Target]) -> list[int]:
    """Order for a policy that gives none.

    First the lane changes into lanes that offer more room than the present one (most room first), then FASTER,
    IDLE, SLOWER, then the other lane changes. The proposal itself is left out. The shield tries to hold a
    longitudinal proposal back at each frame before it falls from the first group to the second.

    Through a sensor with noise a lane has to offer more room by what it may be off; and who cannot tell keeps right:
    the lane to the right comes first unless it offers less by that.
    """
    labels = scene.control.actions
    here, doubt = _room(scene, scene.road.lane_at(float(scene.ego_road[RoadState.R])))
    moves: list[tuple[float, int]] = []
    rest: list[tuple[float, int]] = []
    for a, label in enumerate(labels):
        if a == proposed or not label.startswith("LANE"):
            continue
        if targets[a].lane == scene.control.target.lane:
            continue
        progress, unsure = _room(scene, targets[a].lane)
        gain, within = progress - here, max(doubt, unsure)
        if scene.blurred and label == "LANE_RIGHT" and gain > -within:
            gain, within = CLEAR, 0.0
        (moves if gain > GAIN + within else rest).append((-gain, a))
    longitudinal = [labels.index(x) for x in ("FASTER", "IDLE", "SLOWER") if x in labels]
    return [a for _, a in sorted(moves)] + [a for a in longitudinal if a != proposed] + [a for _, a in sorted(rest)]


def resolve(order: Order) -> list[int] | None:
    """The order as a list, asking for it if need be; None where the policy fails to give one."""
    try:
        found = order() if callable(order) else order
    except Exception:
        # An override is due: a policy whose scores break must not stand in its way.
        return None
    return None if found is None else [int(a) for a in found]
