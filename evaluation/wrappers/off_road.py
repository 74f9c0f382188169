"""Penalty for leaving the road, and re-entry."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from highway_env.vehicle.controller import ControlledVehicle

from evaluation.measuring.recorder import is_off_road
from evaluation.wrappers.checks import check_highway_env, check_number
from shield.errors import ConfigError

__all__ = ["OffRoadWrapper"]


class OffRoadWrapper(gym.Wrapper[Any, Any, Any, Any]):
    """Takes a penalty from the reward of each decision that ends off the road, and puts the ego back.

    The ego returns to the centre line of its nearest lane, with the lane's heading and its own speed. The observation
    is the one after re-entry. A decision that ends the episode is penalised without re-entry. `info` contains
    "off_road" and "re_entered". On a parking lot the ego is never off the road.

    Parameters
    ----------
    env : an environment of highway-env, without a wrapper in between that changes its observations.
    penalty : deduction from the reward, 0 or more.
    re_entry : whether the ego is put back.

    Raises
    ------
    ConfigError
        If the penalty is negative or not finite, or there is such a wrapper: put it around this one.

    Examples
    --------
    >>> from evaluation.settings import get_setting
    >>> env = OffRoadWrapper(get_setting("highway-fast").make(), penalty=5.0)
    >>> _ = env.reset(seed=0)
    >>> ego = env.unwrapped.vehicle
    >>> ego.position[1] = -30.0
    >>> _, reward, *_, info = env.step(1)
    >>> reward, info["off_road"], info["re_entered"], float(ego.position[1])
    (-5.0, True, True, 0.0)
    """

    def __init__(self, env: gym.Env[Any, Any], penalty: float = 1.0, re_entry: bool = True) -> None:
        check_highway_env(env, "OffRoadWrapper")
        check_number("penalty", penalty, least=0.0)
        if env.observation_space != env.unwrapped.observation_space:
            raise ConfigError("OffRoadWrapper observes anew on re-entry: put wrappers of observations around it")
        super().__init__(env)
        self.penalty, self.re_entry = float(penalty), bool(re_entry)

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        """Reset the environment; the ego begins on the road."""
        observation, info = self.env.reset(**kwargs)
        return observation, {**info, "off_road": False, "re_entered": False}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step the environment, with the penalty and re-entry."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        base: Any = self.unwrapped
        off_road = is_off_road(base)
        back = off_road and self.re_entry and not (terminated or truncated)
        if back:
            _put_back(base.vehicle)
            observation = base.observation_type.observe()
        paid = float(reward) - self.penalty * off_road
        return observation, paid, terminated, truncated, {**info, "off_road": off_road, "re_entered": back}


def _put_back(vehicle: Any) -> None:
    lane = vehicle.lane
    along = float(np.clip(lane.local_coordinates(vehicle.position)[0], 0.0, lane.length))
    vehicle.position = np.array(lane.position(along, 0.0), float)
    vehicle.heading = float(lane.heading_at(along))
    if isinstance(vehicle, ControlledVehicle):
        vehicle.target_lane_index = vehicle.lane_index
