"""`LaneFeatures`: the vehicle ahead in each lane and its speed, from Kinematics rows."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from shield.errors import ConfigError

__all__ = ["LaneFeatures"]

_FEATURES = 5
_GAP, _SPEED = 8.0, 8.0
"""Scales of the normalised range: with highway-env's ranges a gap of 25 m decays to 1/e, and 10 m/s is 1."""


class LaneFeatures(BaseFeaturesExtractor):
    """The nearest vehicle ahead in each of the lanes around the ego's: nearness exp(-8 x), relative speed, presence.

    With these features a network need not learn the lane of each row. Rows are highway-env's default ones: presence, x,
    y, vx, vy, normalised and relative to the ego, which is the first. A vehicle beside or behind has x <= 0 and counts
    as very near.

    Parameters
    ----------
    observation_space : space of Kinematics rows, (vehicles, 5).
    reach : number of lanes to each side.
    lane_width : width of a lane in the units of y. highway-env's range of y is four metres for each lane, so it is one
        over the number of lanes.

    Raises
    ------
    ConfigError
        If the observations have another shape, or a number is out of range.

    Examples
    --------
    >>> space = gym.spaces.Box(-1.0, 1.0, (5, 5))
    >>> LaneFeatures(space)(torch.zeros((3, 5, 5))).shape
    torch.Size([3, 18])
    """

    def __init__(self, observation_space: gym.spaces.Box, reach: int = 2, lane_width: float = 0.25) -> None:
        shape: Any = observation_space.shape
        if len(shape) != 2 or shape[1] != _FEATURES:
            raise ConfigError(f"LaneFeatures reads rows of presence, x, y, vx, vy; observations are of shape {shape}")
        if reach < 0 or lane_width <= 0:
            raise ConfigError(
                f"LaneFeatures takes a reach from 0 on and a lane_width above 0, not {reach}, {lane_width}"
            )
        lanes = 2 * reach + 1
        super().__init__(observation_space, features_dim=3 + 3 * lanes)
        self.lane_width = lane_width
        self.register_buffer("middles", torch.arange(-reach, reach + 1) * lane_width)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Features of each observation, (n, vehicles, 5) to (n, 3 + 3 lanes)."""
        ego, others = observations[:, 0], observations[:, 1:]
        there, x, y, speed = others[:, :, 0] > 0.5, others[:, :, 1], others[:, :, 2], others[:, :, 3]
        middles: Any = self.middles
        within = there[:, None] & ((y[:, None] - middles[None, :, None]).abs() < 0.6 * self.lane_width)
        gap, nearest = torch.where(within, x[:, None].expand_as(within), torch.inf).min(-1)
        taken = torch.isfinite(gap)
        relative = torch.gather(speed[:, None].expand_as(within), 2, nearest[..., None])[..., 0]
        nearness = torch.exp(-_GAP * torch.where(taken, gap, 0.5))
        own = torch.stack([ego[:, 2] / self.lane_width - 1.5, ego[:, 3] * _SPEED - 2.5, ego[:, 4] * 2 * _SPEED], 1)
        return torch.cat([own, nearness, torch.where(taken, relative, 0.0) * _SPEED, taken.float()], 1)
