"""Path of the proposal, driven by a copy of the ego in highway-env's own simulation."""

from __future__ import annotations

from contextlib import suppress
from copy import copy
from typing import Any

import numpy as np

from dynamics.roads.straight import Road
from dynamics.state import FloatArray
from evaluation.report.draw import WorldFrame

__all__ = ["action_labels", "ego_copy", "proposed_path"]


def ego_copy(base: Any) -> Any:
    """A copy of the ego in its present state, which refers to the road but is not part of it."""
    ego = copy(base.vehicle)
    ego.__dict__.pop("act", None)  # a supervised `act` is bound to the original ego
    ego.position, ego.action = ego.position.copy(), dict(ego.action)
    if hasattr(ego, "route"):  # driving removes finished lanes from the route in place
        ego.route = copy(ego.route)
    return ego


def proposed_path(base: Any, ego: Any, action: Any, road: Road | WorldFrame) -> FloatArray | None:
    """Road states of a copied ego under an action, until the next decision, (frames + 1, 4).

    Parameters
    ----------
    base : the environment without its wrappers.
    ego : result of `ego_copy` before the decision; it is driven.
    action : the proposal.
    road : road of the frame of the states.

    Returns
    -------
    The states, or None if the environment cannot execute the action.
    """
    frequency = base.config["simulation_frequency"]
    frames = max(1, int(frequency // base.config["policy_frequency"]))
    kind = base.action_type
    states = [[*ego.position, ego.heading, ego.speed]]
    acting = copy(kind)
    acting.controlled_vehicle = ego
    with suppress(KeyError, ValueError, TypeError, IndexError, AssertionError):
        acting.act(action)
        for _ in range(frames):
            if hasattr(ego, "target_speed"):
                ego.act()
            ego.step(1 / frequency)
            states.append([*ego.position, ego.heading, ego.speed])
        return np.asarray(road.to_road(np.array(states)))
    return None


def action_labels(action_type: Any) -> tuple[str, ...]:
    """Names of meta-actions by index; empty for throttle and steering."""
    if type(action_type).__name__ != "DiscreteMetaAction":
        return ()
    return tuple(action_type.actions[i] for i in sorted(action_type.actions))
