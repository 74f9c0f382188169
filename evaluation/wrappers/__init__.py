"""Gymnasium wrappers around any environment of highway-env: observations, rewards, the way back to the road, and a log."""

from __future__ import annotations

from evaluation.wrappers.on_lane_reward import OnLane, OnLaneReward
from evaluation.wrappers.signed_lane import SignedLaneObservation

__all__ = [
    "OnLane",
    "OnLaneReward",
    "SignedLaneObservation",
]
