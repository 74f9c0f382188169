"""Reward with the terms of HanoiWorld (Dat et al. 2026): collision, safe distance, lane change, heading, survival.

The terms are those named in the paper; the formulas below and the default weights are this library's.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any

import gymnasium as gym
import numpy as np

from evaluation.wrappers.checks import check_highway_env, check_number
from evaluation.wrappers.signed_lane import lane_offset

__all__ = ["HanoiWeights", "HanoiWorldReward"]


@dataclass(frozen=True, slots=True)
class HanoiWeights:
    """Weights of the terms, and parameters of their definition.

    Attributes
    ----------
    collision : 1 in a crash.
    safe_distance : missing share of the safe gap to the vehicle ahead on the same lane, 0 to 1.
    lane_change : 1 in a decision after which the ego is on another lane of the same road.
    heading : cosine of the heading relative to the lane.
    survival : 1 in a decision without a crash.
    time_gap : the safe gap is the distance driven in this time [s], plus `standstill`.
    standstill : safe gap at a standstill [m].

    Raises
    ------
    ConfigError
        If a value is not finite, or a gap is negative.
    """

    collision: float = -1.0
    safe_distance: float = -0.5
    lane_change: float = -0.05
    heading: float = 0.2
    survival: float = 0.1
    time_gap: float = 1.5
    standstill: float = 2.0

    def __post_init__(self) -> None:
        for field in fields(self):
            least = 0.0 if field.name in ("time_gap", "standstill") else -np.inf
            check_number(field.name, getattr(self, field.name), least)


class HanoiWorldReward(gym.Wrapper[Any, Any, Any, Any]):
    """Rewards by the weighted sum of the terms of `HanoiWeights`; `info["hanoi_terms"]` has each unweighted term.

    Parameters
    ----------
    env : an environment of highway-env.
    weights : options.

    Examples
    --------
    >>> from evaluation.settings import get_setting
    >>> env = HanoiWorldReward(get_setting("highway-fast").make())
    >>> _ = env.reset(seed=0)
    >>> _, reward, *_, info = env.step(1)
    >>> sorted(info["hanoi_terms"])
    ['collision', 'heading', 'lane_change', 'safe_distance', 'survival']
    """

    def __init__(self, env: gym.Env[Any, Any], weights: HanoiWeights | None = None) -> None:
        check_highway_env(env, "HanoiWorldReward")
        super().__init__(env)
        self.weights = weights or HanoiWeights()
        self._lane: tuple[str, str, int] | None = None

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        """Reset the environment."""
        result = self.env.reset(**kwargs)
        self._lane = self.unwrapped.vehicle.lane_index  # type: ignore[attr-defined]
        return result

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step the environment, with this reward."""
        observation, _, terminated, truncated, info = self.env.step(action)
        base: Any = self.unwrapped
        lane, before = base.vehicle.lane_index, self._lane
        self._lane = lane
        changed = before is not None and lane[:2] == before[:2] and lane[2] != before[2]
        terms = {
            "collision": float(base.vehicle.crashed),
            "safe_distance": _missing_gap(base, self.weights),
            "lane_change": float(changed),
            "heading": float(np.cos(lane_offset(base.vehicle).heading)),
            "survival": float(not base.vehicle.crashed),
        }
        weights = asdict(self.weights)
        reward = float(sum(weights[name] * value for name, value in terms.items()))
        return observation, reward, terminated, truncated, {**info, "hanoi_terms": terms}


def _missing_gap(base: Any, weights: HanoiWeights) -> float:
    """Missing share of the safe gap; 0 without a vehicle ahead."""
    ego = base.vehicle
    ahead, _ = base.road.neighbour_vehicles(ego)
    safe = weights.standstill + weights.time_gap * max(float(ego.speed), 0.0)
    if ahead is None or safe == 0.0:
        return 0.0
    gap = float(np.hypot(*(ahead.position - ego.position))) - 0.5 * (ego.LENGTH + ahead.LENGTH)
    return float(np.clip(1.0 - gap / safe, 0.0, 1.0))
