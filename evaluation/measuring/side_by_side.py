"""Measures of the decisions of a batch of compiled episodes, beside those of `tally`."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.vehicle.kinematics import Vehicle

from dynamics.state import BoolArray, FloatArray

__all__ = ["BatchMeasures"]

_SPEED, _CRASHED = 3, 6


class BatchMeasures:
    """Sums over the present episode of each environment, (e,).

    Parameters
    ----------
    envs : number of environments.
    steps : steps of each meta-action, see `evaluation.running.decision_log.action_steps`, (actions, 2).
    """

    def __init__(self, envs: int, steps: FloatArray) -> None:
        self._apart = np.abs(steps[:, None] - steps).sum(axis=-1)
        self._distance, self._on_lane, self._speed = np.zeros(envs), np.zeros(envs), np.zeros(envs)
        self._reward, self._peak_speed = np.full(envs, -np.inf), np.zeros(envs)
        self._crashed = np.zeros(envs, np.bool_)

    def begin(self, e: int, speed: float) -> None:
        """Reset the sums of environment `e` for an episode that starts at this speed [m/s]."""
        self._distance[e] = self._on_lane[e] = self._speed[e] = 0.0
        self._reward[e], self._peak_speed[e], self._crashed[e] = -np.inf, speed, False

    def add(self, records: Any, rows: FloatArray, off_road: BoolArray, reward: FloatArray, going: BoolArray) -> None:
        """Add a decision of each environment that is `going`, (e,); the other parameters as in `tally`."""
        ego = rows[:, :, 0]
        crashes = ego[..., _CRASHED] > 0
        # Frames up to and including the first crash.
        before = (np.cumsum(crashes, axis=1) - crashes > 0) | self._crashed[:, None]
        peaks = np.where(before, -np.inf, ego[..., _SPEED]).max(axis=1)
        self._peak_speed = np.where(going, np.maximum(self._peak_speed, peaks), self._peak_speed)
        self._crashed |= going & crashes.any(axis=1)
        self._distance += going * self._apart[records.proposed, records.executed]
        self._on_lane += going & ~off_road[:, -1]
        self._speed += going * np.clip(ego[:, -1, _SPEED] / Vehicle.MAX_SPEED, 0.0, 1.0)
        self._reward = np.where(going, np.maximum(self._reward, reward), self._reward)

    def columns(self, e: int, steps: int) -> dict[str, float]:
        """Columns of `EpisodeRecord` for the episode in environment `e`, which had `steps` decisions."""
        return {
            "input_distance": float(self._distance[e] / steps),
            "on_lane_share": float(self._on_lane[e] / steps),
            "peak_reward": float(self._reward[e]),
            "peak_speed": float(self._peak_speed[e]),
            "mean_normalised_speed": float(self._speed[e] / steps),
        }
