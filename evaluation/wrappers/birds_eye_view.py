"""Bird's-eye frames as observations."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from dynamics.world_model import BirdsEye, FrameView, composite
from evaluation.wrappers.checks import check_highway_env

__all__ = ["BirdsEyeView"]


class BirdsEyeView(gym.ObservationWrapper[Any, Any, Any]):
    """Replaces the observation by a bird's-eye frame around the ego, (5, size, size) uint8.

    Policies that learn from images, such as Stable-Baselines3's `CnnPolicy`, train on it.
    The frame is drawn from the simulator's state: it has no noise and no occlusion.

    Parameters
    ----------
    env : an environment of highway-env; a `ShieldedEnv` around it may be inside or outside.
    view : part of the scene that the frame shows; see `dynamics.world_model.FrameView` for the channels.
    colour : observe the colour picture of the frame instead, (3, size, size) uint8.

    Raises
    ------
    ConfigError
        If this is no environment of highway-env.
    SceneError
        At the reset, if a lane is neither straight nor a sine nor an arc.

    Examples
    --------
    >>> from evaluation.settings import get_setting
    >>> env = BirdsEyeView(get_setting("roundabout").make())
    >>> observation, info = env.reset(seed=0)
    >>> observation.shape, observation.dtype
    ((5, 64, 64), dtype('uint8'))
    """

    def __init__(self, env: gym.Env[Any, Any], view: FrameView | None = None, colour: bool = False) -> None:
        check_highway_env(env, "BirdsEyeView")
        super().__init__(env)
        self._draws, self._colour = BirdsEye(view), colour
        shape = self._draws.view.shape
        self.observation_space = spaces.Box(0, 255, (3, *shape[1:]) if colour else shape, np.uint8)

    def observation(self, observation: Any) -> NDArray[np.uint8]:
        """The frame of the present scene; the observation itself is not read."""
        frame = self._draws.frame(self)
        return np.moveaxis(composite(frame), -1, 0).copy() if self._colour else frame
