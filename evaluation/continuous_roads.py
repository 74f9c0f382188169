"""Roads that highway-env makes with meta-actions only, and their ids with throttle and steering."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["ROADS", "continuous_id", "continuous_remedy"]

ROADS = (
    *(f"{road}-v{k}" for road in ("merge", "merge-generic", "roundabout", "roundabout-generic") for k in (0, 1)),
    *("two-way-v0", "u-turn-v0", "u-turn-v1"),
)
"""Environments that highway-env cannot make with `ContinuousAction`."""

_LAST = dict(road.rsplit("-", 1) for road in ROADS)
"""Last version of each road."""


def continuous_id(road: str) -> str:
    """The Gymnasium id of one of `ROADS` with throttle and steering; importing `evaluation.wrappers` registers it."""
    name, version = road.rsplit("-", 1)
    return f"{name}-continuous-{version}"


def continuous_remedy(env_id: str, config: Mapping[str, Any]) -> str:
    """Message about an environment that highway-env itself cannot make, with the remedy.

    Parameters
    ----------
    env_id : its Gymnasium id.
    config : changes to its default configuration.

    Returns
    -------
    The message; "" if the id is not in `ROADS`, or the actions are of another type.
    """
    road, action = env_id.rpartition(":")[2], config.get("action")
    kind = action.get("type") if isinstance(action, Mapping) else None
    if road not in ROADS or kind not in ("ContinuousAction", "DiscreteAction"):
        return ""
    registered = ", ".join(continuous_id(f"{name}-{version}") for name, version in _LAST.items())
    return (
        f"highway-env itself does not make {road} with throttle and steering ({kind}): its rewards and observations "
        f"ask for meta-actions. Have evaluation.wrappers:{continuous_id(road)} instead, or "
        f'evaluation.wrappers.ThrottleAndSteering(gym.make("{road}")); evaluation.wrappers registers {registered}'
    )
