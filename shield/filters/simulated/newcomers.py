"""Bodies that the simulation did not predict, and those that leave the egos without a verified sequence."""

from __future__ import annotations

from collections.abc import Callable, Set
from copy import copy
from typing import Any

from dynamics.road_networks.simulation.supported_traffic import may_have_spawned

__all__ = ["blocking", "unpredicted"]

Verifies = Callable[[Any], bool]
"""Whether any sequence of actions verifies in an environment, unwrapped; False if it cannot be simulated."""


def unpredicted(base: Any, predicted: Set[Any]) -> set[Any]:
    """Vehicles and obstacles that were not predicted, without the egos and those that highway-env may have spawned
    itself.

    Parameters
    ----------
    base : highway-env's environment, unwrapped. predicted : the bodies of the predicted scene.
    """
    known = predicted | set(base.controlled_vehicles)
    bodies = (*base.road.vehicles, *base.road.objects)
    return {body for body in bodies if body not in known and not may_have_spawned(base, body)}


def blocking(base: Any, newcomers: set[Any], verifies: Verifies) -> set[Any]:
    """Newcomers that have crashed with an ego, or without which some sequence of actions would verify.

    If several block only together, all are returned.

    Parameters
    ----------
    base : highway-env's environment, unwrapped, in its present state.
    newcomers : its vehicles and obstacles that were not predicted.
    verifies : check for an environment, unwrapped.
    """
    if not newcomers:
        return set()
    if any(ego.crashed for ego in base.controlled_vehicles):
        return {body for body in newcomers if body.crashed or getattr(body, "hit", False)}
    if verifies(base) or not verifies(_without(base, newcomers)):
        return set()
    if len(newcomers) == 1:
        return newcomers
    alone = {body for body in newcomers if not verifies(_without(base, newcomers - {body}))}
    return alone or newcomers


def _without(base: Any, bodies: set[Any]) -> Any:
    """View of an environment without some bodies; the environment stays unchanged."""
    view, road = copy(base), copy(base.road)
    road.vehicles = [body for body in road.vehicles if body not in bodies]
    road.objects = [body for body in road.objects if body not in bodies]
    view.road = road
    return view
