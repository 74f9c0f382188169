"""Roads that highway-env makes with meta-actions alone, and what they are called with throttle and steering."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["ROADS", "continuous_id", "what_makes"]

ROADS = (
    *(f"{road}-v{k}" for road in ("merge", "merge-generic", "roundabout", "roundabout-generic") for k in (0, 1)),
    *("two-way-v0", "u-turn-v0", "u-turn-v1"),
)
"""What highway-env does not make with `ContinuousAction`."""

_LAST = dict(road.rsplit("-", 1) for road in ROADS)
"""The last version of each."""


def continuous_id(road: str) -> str:
    """The Gymnasium id of one of `ROADS` with throttle and steering; importing `evaluation.wrappers` registers it."""
    name, version = road.rsplit("-", 1)
    return f"{name}-continuous-{version}"


def what_makes(env_id: str, config: Mapping[str, Any]) -> str:
    """What makes an environment that highway-env itself does not, in words; "" where it is none of `ROADS`, or has
    other actions.

    Parameters
    ----------
    env_id : its Gymnasium id. config : what differs from its default configuration.
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
