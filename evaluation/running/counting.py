"""Counts for the record of an episode: what the shield did in each decision, and how the ego drove."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, cast

import gymnasium as gym
import numpy as np

from dynamics.roads.path import PathRoad
from evaluation.measuring.recorder import History, Track
from shield.decision import Intervention, Reason, Tier

__all__ = ["UNSHIELDED", "Tally", "arrival", "driving"]

UNSHIELDED: dict[str, Any] = {
    "overridden": False,
    "intervention": Intervention.NONE.value,
    "frames_overridden": 0,
    "violations": None,
    "rules": {},
    "margin": float("nan"),
    "reason": Reason.NONE.value,
    "tier": Tier.OFF.value,
}
"""Report of a decision without a shield."""


@dataclass(slots=True)
class Tally:
    """Counts of an episode, added up over its decisions."""

    overridden: int = 0
    held_back: int = 0
    frames_overridden: int = 0
    violations: int | None = 0
    rules: Counter[str] = field(default_factory=Counter)
    min_margin: float = float("nan")
    reasons: Counter[str] = field(default_factory=Counter)
    tiers: Counter[str] = field(default_factory=Counter)
    latencies: list[float] = field(default_factory=list)

    def add(self, shield: Mapping[str, Any]) -> None:
        """Add a decision; `shield` holds `info["shield"]` and `latency_ms`."""
        self.overridden += bool(shield["overridden"])
        self.held_back += shield["intervention"] == Intervention.HELD_BACK
        self.frames_overridden += int(shield["frames_overridden"])
        violations = shield["violations"]
        if violations is None or self.violations is None:
            self.violations = None
        else:
            self.violations += int(violations)
        if shield["rules"]:
            self.rules.update(shield["rules"])
        margin = float(shield["margin"])
        if math.isfinite(margin) and not self.min_margin <= margin:  # the least so far is NaN at first
            self.min_margin = margin
        self.reasons[Reason(shield["reason"]).value] += 1
        self.tiers[Tier(shield["tier"]).value] += 1
        self.latencies.append(float(shield["latency_ms"]))


def arrival(info: Mapping[str, Any], env: gym.Env[Any, Any], history: History) -> dict[str, Any]:
    """Whether the ego reached the goal, and its speed there [m/s]; an arrival with a crash is no success.

    Success comes from `info`, or from the intersection's own method. Other environments have None and NaN.
    """
    base = cast(Any, env.unwrapped)
    if "is_success" in info:
        reached = bool(np.all(info["is_success"]))
    elif hasattr(base, "has_arrived"):
        reached = bool(base.has_arrived(base.vehicle))
    else:
        return {"success": None, "arrival_speed": math.nan}
    success = reached and history.crash_frame is None
    speed = abs(float(history.ego[-1, Track.SPEED]))
    return {"success": success, "arrival_speed": speed if success else math.nan}


def driving(history: History) -> dict[str, Any]:
    """Duration [s], speed [m/s], distance [m], lane changes and laps of the ego, up to a crash."""
    crash, road = history.crash_frame, history.road
    ego = history.ego if crash is None else history.ego[: crash + 1]
    driving = {"duration": (len(ego) - 1) * history.dt, "mean_speed": float(ego[:, Track.SPEED].mean())}
    if road is None:
        steps = np.diff(ego[:, [Track.S, Track.R]], axis=0)
        way = float(np.hypot(steps[:, 0], steps[:, 1]).sum())
        return driving | {"distance": way, "lane_changes": np.nan, "laps": np.nan}
    way = float(ego[-1, Track.S] - ego[0, Track.S])
    lanes = [road.lane_at(float(r)) for r in ego[:, Track.R]]
    closed = isinstance(road, PathRoad) and road.closed
    return driving | {
        "distance": way,
        "lane_changes": float(np.count_nonzero(np.diff(lanes))),
        "laps": way / road.length if closed else np.nan,
    }
