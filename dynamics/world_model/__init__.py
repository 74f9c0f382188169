"""Bird's-eye frames of a scene, for drivers and world models that learn from images."""

from __future__ import annotations

from dynamics.world_model.birds_eye import BirdsEye, composite
from dynamics.world_model.view import CHANNELS, FrameView

__all__ = ["CHANNELS", "BirdsEye", "FrameView", "composite"]
