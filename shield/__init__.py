"""A runtime safety shield around learned driving policies on highway-env."""

from __future__ import annotations

from dynamics.traffic.assumptions import Assumptions
from shield.config import Buffer, ShieldConfig
from shield.decision import Decision, Reason, Tier
from shield.doors.env import ShieldedEnv
from shield.doors.policy import Shield
from shield.errors import ActionError, ConfigError, PolicyError, SceneError, ShieldError

__all__ = [
    "ActionError",
    "Assumptions",
    "Buffer",
    "ConfigError",
    "Decision",
    "PolicyError",
    "Reason",
    "SceneError",
    "Shield",
    "ShieldConfig",
    "ShieldError",
    "ShieldedEnv",
    "Tier",
]
