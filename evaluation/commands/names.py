"""What the commands take where nothing else is asked for."""

from __future__ import annotations

__all__ = ["DEMO_POLICY", "DEMO_SETTING"]

DEMO_SETTING, DEMO_POLICY = "highway-fast", "ppo-highway-fast"
