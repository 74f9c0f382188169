"""highway-env's lane keeping, with the constructor of other environments."""

from __future__ import annotations

from typing import Any

from highway_env.envs.lane_keeping_env import LaneKeepingEnv

__all__ = ["DrawnLaneKeepingEnv"]


class DrawnLaneKeepingEnv(LaneKeepingEnv):  # type: ignore[misc]
    """`lane-keeping-v0` with a `render_mode`; highway-env 1.12 raises TypeError for it."""

    def __init__(self, config: dict[str, Any] | None = None, render_mode: str | None = None) -> None:
        super().__init__(config)
        self.render_mode = render_mode
