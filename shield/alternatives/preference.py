"""Order in which alternatives are tried: the policy's own order if it has one, otherwise a documented default."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dynamics.scenes.scene import Scene, Target
from dynamics.state import RoadState, Vehicle

__all__ = ["CLEAR", "GAIN", "IN_LANE", "RELATIVE_SPEED_WEIGHT", "Order", "default_order", "lane_progress", "resolve"]

Order = Sequence[int] | Callable[[], Sequence[int] | None] | None
"""Alternatives in order of preference, or a function that is called only when an override is due."""

IN_LANE = 0.625
"""Distance from a lane's centre within which a vehicle counts as in it, in widths of a lane."""
RELATIVE_SPEED_WEIGHT = 3.0
"""Weight of a leader's relative speed against its distance [s]."""
CLEAR = 1000.0
"""Progress of a lane with no vehicle ahead [m]."""
GAIN = 5.0
"""Least difference in progress at which another lane is preferred to the ego's [m]."""


def lane_progress(scene: Scene, lane: int) -> float:
    """Progress that a lane offers: distance to the first vehicle ahead plus 3 s of its relative speed [m]."""
    return _gap_ahead(scene, lane)[0]


def _gap_ahead(scene: Scene, lane: int) -> tuple[float, float]:
    """Progress of a lane, and its uncertainty [m]: with a noisy sensor, the extents of a body are upper bounds."""
    states, ego = scene.others_road, scene.ego_road
    ahead = (np.abs(states[:, RoadState.R] - scene.road.centers[lane]) < IN_LANE * scene.road.width) & (
        states[:, RoadState.S] > ego[RoadState.S]
    )
    if not ahead.any():
        return CLEAR, 0.0
    gaps = states[ahead, RoadState.S] - ego[RoadState.S]
    j = int(gaps.argmin())
    progress = float(gaps[j] + RELATIVE_SPEED_WEIGHT * (states[ahead, RoadState.SPEED][j] - ego[RoadState.SPEED]))
    if not scene.blurred:
        return progress, 0.0
    return progress, max(0.0, float(scene.others[ahead, Vehicle.LENGTH][j] - scene.ego[Vehicle.LENGTH]) / 2)


def default_order(scene: Scene, proposed: int, targets: list[Target]) -> list[int]:
    """Order for a policy without one.

    First the lane changes into lanes with more progress than the present one (most progress first), then FASTER, IDLE,
    SLOWER, then the other lane changes. The proposal itself is left out. For a longitudinal proposal, the shield tries
    an acceleration cap in each frame before it goes from the first group to the second.

    With a noisy sensor, a lane has to offer more progress by its uncertainty. The lane to the right then comes first,
    unless it offers less progress by that uncertainty.
    """
    labels = scene.control.actions
    here, doubt = _gap_ahead(scene, scene.road.lane_at(float(scene.ego_road[RoadState.R])))
    moves: list[tuple[float, int]] = []
    rest: list[tuple[float, int]] = []
    for a, label in enumerate(labels):
        if a == proposed or not label.startswith("LANE"):
            continue
        if targets[a].lane == scene.control.target.lane:
            continue
        progress, unsure = _gap_ahead(scene, targets[a].lane)
        gain, within = progress - here, max(doubt, unsure)
        if scene.blurred and label == "LANE_RIGHT" and gain > -within:
            gain, within = CLEAR, 0.0
        (moves if gain > GAIN + within else rest).append((-gain, a))
    longitudinal = [labels.index(x) for x in ("FASTER", "IDLE", "SLOWER") if x in labels]
    return [a for _, a in sorted(moves)] + [a for a in longitudinal if a != proposed] + [a for _, a in sorted(rest)]


def resolve(order: Order) -> list[int] | None:
    """The order as a list, calling its function if needed; None if the policy fails to give one."""
    try:
        found = order() if callable(order) else order
    except Exception:
        # An override is due, and an error in the policy's scores must not prevent it.
        return None
    return None if found is None else [int(a) for a in found]
