"""Gymnasium wrappers for environments of highway-env: observations, rewards, re-entry to the road, and a log."""

from __future__ import annotations

from evaluation.wrappers.birds_eye_view import BirdsEyeView
from evaluation.wrappers.channels import Confidence, Intent, TrackedConfidence, seen_through
from evaluation.wrappers.hanoi_reward import HanoiWeights, HanoiWorldReward
from evaluation.wrappers.off_road import OffRoadWrapper
from evaluation.wrappers.on_lane_reward import OnLane, OnLaneReward
from evaluation.wrappers.override_penalty import OverridePenalty
from evaluation.wrappers.performance_logger import PerformanceLogger
from evaluation.wrappers.sensor_model import SENSORS, SensorModel
from evaluation.wrappers.sensor_noise import SensorNoise
from evaluation.wrappers.signed_lane import LaneOffset, SignedLaneObservation
from evaluation.wrappers.skills import REPORT_SKILLS, Skills, nearer_than, overridden
from evaluation.wrappers.throttle_and_steering import ThrottleAndSteering

__all__ = [
    "REPORT_SKILLS",
    "SENSORS",
    "BirdsEyeView",
    "Confidence",
    "HanoiWeights",
    "HanoiWorldReward",
    "Intent",
    "LaneOffset",
    "OffRoadWrapper",
    "OnLane",
    "OnLaneReward",
    "OverridePenalty",
    "PerformanceLogger",
    "SensorModel",
    "SensorNoise",
    "SignedLaneObservation",
    "Skills",
    "ThrottleAndSteering",
    "TrackedConfidence",
    "nearer_than",
    "overridden",
    "seen_through",
]
