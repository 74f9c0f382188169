"""Check that the environment that the shield reads is the one that is driven."""

from __future__ import annotations

from typing import Any

import numpy as np

from shield.environments import check_single_decision
from shield.errors import SceneError

__all__ = ["StaleEnvironmentCheck"]


class StaleEnvironmentCheck:
    """Detects an environment that stands still while its observations change.

    Parameters
    ----------
    base : the highway-env environment that the shield reads, unwrapped.
    """

    def __init__(self, base: Any) -> None:
        self._base = base
        self._last: tuple[Any, Any, bytes] | None = None

    def check(self, observation: Any) -> None:
        """Compare with the last observation.

        Raises
        ------
        SceneError
            If the observation has changed, and neither the episode nor the environment's clock has.
        ConfigError
            If the environment has executed more than one decision since.
        """
        road, frame, seen = self._base.road, getattr(self._base, "steps", None), _bytes(observation)
        last, self._last = self._last, (road, frame, seen)
        if last is None or last[0] is not road:
            return
        if frame is not None and last[1] is not None:
            check_single_decision(self._base, last[1])
        if last[1] == frame and last[2] != seen:
            raise SceneError(
                "the shield reads an environment that is not driven: the observation has changed, but its episode "
                f"stands at frame {frame}. Pass the environment that is driven: Shield(model, env=env), and not only "
                "PPO.load(path, env=env)"
            )


def _bytes(observation: Any) -> bytes:
    """Bytes of an observation, for a comparison."""
    if isinstance(observation, dict):
        return b"".join(_bytes(observation[key]) for key in sorted(observation))
    if isinstance(observation, tuple | list):
        return b"".join(map(_bytes, observation))
    return np.asarray(observation).tobytes()
