"""Defaults of the commands."""

from __future__ import annotations

__all__ = ["DEMO_POLICY", "DEMO_SETTING", "EVALUATION_SEED"]

DEMO_SETTING, DEMO_POLICY = "highway-fast", "ppo-highway-fast"
EVALUATION_SEED = 100_000
"""Default seed of the first evaluation episode."""
