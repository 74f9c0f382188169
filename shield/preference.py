"""In which order alternatives are tried: the policy's own where it has one, else a documented default."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from dynamics.scene import Scene, Target
from dynamics.state import RoadState

__all__ = ["Order", "default_order", "lane_progress", "order_from_scores", "ranking_of", "resolve"]

Order = Sequence[int] | Callable[[], Sequence[int] | None] | None
"""Alternatives in order of preference, or a function that is asked only when an override is due."""

_OUTLOOK = 3.0
"""Weight of a leader's relative speed against its distance [s]."""
_CLEAR = 1000.0
"""Progress of a lane with nobody ahead [m]."""
_GAIN = 5.0
"""Least progress by which another lane must be better than the ego's before it is preferred [m]."""


def lane_progress(scene: Scene, lane: int) -> float:
    """How much room a lane offers: distance to the first vehicle ahead plus 3 s of its relative speed [m]."""
    states, ego = scene.others_road, scene.ego_road
    ahead = (np.abs(states[:, RoadState.R] - scene.road.centers[lane]) < 0.625 * scene.road.width) & (
        states[:, RoadState.S] > ego[RoadState.S]
    )
    if not ahead.any():
        return _CLEAR
    room = states[ahead, RoadState.S] - ego[RoadState.S]
    j = int(room.argmin())
    return float(room[j] + _OUTLOOK * (states[ahead, RoadState.SPEED][j] - ego[RoadState.SPEED]))


def default_order(scene: Scene, proposed: int, targets: list[Target]) -> list[int]:
    """Order for a policy that gives none.

    First the lane changes into lanes that offer more room than the present one (most room first), then FASTER,
    IDLE, SLOWER, then the other lane changes. The proposal itself is left out. The shield tries to hold a
    longitudinal proposal back at each frame before it falls from the first group to the second.
    """
    labels = scene.control.actions
    here = lane_progress(scene, scene.road.lane_at(float(scene.ego_road[RoadState.R])))
    moves: list[tuple[float, int]] = []
    rest: list[tuple[float, int]] = []
    for a, label in enumerate(labels):
        if a == proposed or not label.startswith("LANE"):
            continue
        if targets[a].lane == scene.control.target.lane:
            continue
        gain = lane_progress(scene, targets[a].lane) - here
        (moves if gain > _GAIN else rest).append((-gain, a))
    longitudinal = [labels.index(x) for x in ("FASTER", "IDLE", "SLOWER") if x in labels]
    return [a for _, a in sorted(moves)] + [a for a in longitudinal if a != proposed] + [a for _, a in sorted(rest)]


def ranking_of(policy: Any, obs: Any) -> Any:
    """Preference scores over discrete actions for a batch of observations, shape (n, actions), or None.

    Q-values for value-based models, action probabilities for stochastic ones; higher is preferred. `policy` is an
    SB3 or sb3-contrib model, a bare policy, or any object: one that offers `action_scores(obs)` is asked that.
    None for recurrent policies, whose scores the observation alone does not give.
    """
    import torch

    if hasattr(policy, "action_scores"):
        return np.asarray(policy.action_scores(obs), dtype=float)
    net = getattr(policy, "policy", policy)
    if not hasattr(net, "obs_to_tensor") or hasattr(net, "lstm_actor"):
        return None
    with torch.no_grad():
        tensor, _ = net.obs_to_tensor(obs)
        if hasattr(net, "q_net"):
            return net.q_net(tensor).cpu().numpy().astype(float)
        if hasattr(net, "quantile_net"):
            return net.quantile_net(tensor).mean(dim=1).cpu().numpy().astype(float)
        if hasattr(net, "get_distribution"):
            distribution = getattr(net.get_distribution(tensor), "distribution", None)
            probs = getattr(distribution, "probs", None)
            return None if probs is None else probs.cpu().numpy().astype(float)
    return None


def order_from_scores(scores: Any, proposed: int) -> list[int]:
    """Action indices by falling score, without the proposal; NaN scores come last."""
    scores = np.nan_to_num(np.asarray(scores, dtype=float), nan=-np.inf)
    return [int(a) for a in np.argsort(-scores, kind="stable") if a != proposed]


def resolve(order: Order) -> list[int] | None:
    """The order as a list, asking for it if need be; None where the policy fails to give one."""
    try:
        found = order() if callable(order) else order
    except Exception:
        # An override is due: a policy whose scores break must not stand in its way.
        return None
    return None if found is None else [int(a) for a in found]
