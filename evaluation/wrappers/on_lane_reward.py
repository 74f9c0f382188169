"""The multiplicative reward of Dong et al. 2023 for speed, heading along the lane, and distance to its centre line.

Notation: d is the distance to the centre line of the lane [m], psi the heading relative to the lane [rad], v the speed
[m/s].
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import gymnasium as gym
import numpy as np

from evaluation.wrappers.checks import check_highway_env, check_number
from evaluation.wrappers.signed_lane import LaneOffset, lane_offset
from shield.errors import ConfigError

__all__ = ["OnLane", "OnLaneReward", "on_lane_reward"]


@dataclass(frozen=True, slots=True)
class OnLane:
    """Parameters of the reward: (cos psi)^a (v / V)^b / max(D, |d|)^c for v > 0, else 0.

    The defaults are those of the code of Dong et al. 2023, cos(psi) v / max(1, |d|) / 20 and -10 in a crash.

    Attributes
    ----------
    crash : reward of a decision in which the ego has crashed, instead of the formula.
    speed_scale : V, positive [m/s].
    distance_floor : D, positive; smaller distances have no effect [m].
    heading_exponent, speed_exponent, distance_exponent : a, b and c, from 0 on; a negative cosine keeps its sign.

    Raises
    ------
    ConfigError
        If a value is not finite or out of its range.
    """

    crash: float = -10.0
    speed_scale: float = 20.0
    distance_floor: float = 1.0
    heading_exponent: float = 1.0
    speed_exponent: float = 1.0
    distance_exponent: float = 1.0

    def __post_init__(self) -> None:
        for field in fields(self):
            positive = field.name in ("speed_scale", "distance_floor")
            least = 0.0 if field.name.endswith("exponent") else -np.inf
            check_number(field.name, getattr(self, field.name), least, above=0.0 if positive else -np.inf)

    @classmethod
    def of(cls, options: Any) -> OnLane:
        """Make the parameters from a mapping; raises a `ConfigError` with the valid names for an unknown one."""
        valid = [field.name for field in fields(cls)]
        if not isinstance(options, Mapping):
            raise ConfigError(f"options of the reward map {', '.join(valid)} to numbers, not {options!r}")
        for name in options:
            if name not in valid:
                raise ConfigError(f"unknown option {name!r} of the reward; have {', '.join(valid)}")
        return cls(**options)


def on_lane_reward(offset: LaneOffset, speed: float, crashed: bool, terms: OnLane | None = None) -> float:
    """The reward of a state.

    Parameters
    ----------
    offset : position and heading of the ego relative to its lane.
    speed : speed of the ego [m/s].
    crashed : whether the ego has crashed.
    terms : parameters; the paper's by default.

    Examples
    --------
    >>> on_lane_reward(LaneOffset(distance=0.5, heading=0.0), speed=10.0, crashed=False)
    0.5
    >>> on_lane_reward(LaneOffset(distance=-2.0, heading=0.0), speed=10.0, crashed=False)
    0.25
    """
    terms = terms or OnLane()
    if crashed:
        return terms.crash
    if speed <= 0.0:
        return 0.0
    cosine = float(np.cos(offset.heading))
    along = float(np.copysign(abs(cosine) ** terms.heading_exponent, cosine))
    pace = (speed / terms.speed_scale) ** terms.speed_exponent
    return float(along * pace / max(terms.distance_floor, abs(offset.distance)) ** terms.distance_exponent)


class OnLaneReward(gym.Wrapper[Any, Any, Any, Any]):
    """Rewards by `on_lane_reward`, in place of the environment's own reward.

    Parameters
    ----------
    env : an environment of highway-env.
    terms : parameters; the paper's by default.

    Examples
    --------
    >>> from evaluation.settings import get_setting
    >>> env = OnLaneReward(get_setting("highway-fast").make())
    >>> _ = env.reset(seed=0)
    >>> round(env.step(1)[1], 2)
    1.25
    """

    def __init__(self, env: gym.Env[Any, Any], terms: OnLane | None = None) -> None:
        check_highway_env(env, "OnLaneReward")
        super().__init__(env)
        self.terms = terms or OnLane()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step the environment, with this reward."""
        observation, _, terminated, truncated, info = self.env.step(action)
        vehicle = self.unwrapped.vehicle  # type: ignore[attr-defined]
        reward = on_lane_reward(lane_offset(vehicle), float(vehicle.speed), bool(vehicle.crashed), self.terms)
        return observation, reward, terminated, truncated, info
