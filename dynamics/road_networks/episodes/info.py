"""highway-env's `info` of a decision."""

from __future__ import annotations

from typing import Any

from dynamics.road_networks.episodes.rewards import CROSSING, EXITING
from dynamics.road_networks.episodes.simulator import RoadSimulator

__all__ = ["info_of"]

_YES_OR_NO = frozenset({"collision_reward", "lane_change_reward", "goal_reward", "on_road_reward"})
"""Terms of a reward that are booleans in highway-env, except at intersections, where they are means over the egos."""


def info_of(simulator: RoadSimulator, e: int, action: Any) -> dict[str, Any]:
    """highway-env's `info` of the last decision of one copy, for the executed action."""
    scenario, seen = simulator.scenario, simulator.seen
    crossing = scenario.kind == CROSSING
    parts = dict(zip(scenario.names, seen.parts[e].tolist(), strict=False))
    rewards = {name: bool(x) if name in _YES_OR_NO and not crossing else x for name, x in parts.items()}
    crashed = bool(seen.crashed[e])
    info = {"speed": float(seen.speed[e]), "crashed": crashed, "action": action, "rewards": rewards}
    if scenario.kind == EXITING:
        info["is_success"] = rewards["goal_reward"]
    if crossing:
        info["agents_rewards"] = (float(seen.reward[e]),)
        info["agents_terminated"] = (crashed or rewards["arrived_reward"] != 0,)
    return info
