"""A picture of a whole map, as highway-env draws it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from dynamics.state import FloatArray
from evaluation.report.plots import picture_path
from evaluation.scenarios import ComplexRoadsEnv
from shield.errors import ConfigError

__all__ = ["draw_map"]

_MARGIN = 15.0
"""Margin around the roads [m]."""
_DOT = 6.0
"""Radius of the dot over a vehicle [px]."""
_EGO, _OTHER = (50, 200, 0), (100, 200, 255)


def draw_map(path: str | Path, config: Mapping[str, Any] | None = None, seed: int = 0, width: int = 1600) -> Path:
    """Draw all roads of ComplexRoads-v0 and the vehicles on them.

    Parameters
    ----------
    path : path of the .png file.
    config : changes to the environment's configuration.
    seed : seed of the episode.
    width : width of the picture [px].

    Returns
    -------
    The path.

    Raises
    ------
    ConfigError
        If the file does not end in .png, or the width is less than 1.
    """
    path = picture_path(path)
    if width < 1:
        raise ConfigError(f"a picture has a width of at least 1 px, not {width}")
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
    env = ComplexRoadsEnv(dict(config or {}), render_mode="rgb_array")
    try:
        env.reset(seed=seed)
        lanes = env.road.network.lanes_list()
        ends = np.array(
            [lane.position(along, 0.0) for lane in lanes for along in (0.0, 0.5 * lane.length, lane.length)]
        )
        low, high = ends.min(axis=0) - _MARGIN, ends.max(axis=0) + _MARGIN
        scaling = width / (high - low)[0]
        env.config.update(screen_width=width, screen_height=round(scaling * (high - low)[1]), scaling=scaling)
        env.render()
        env.viewer.enabled = True  # highway-env draws nothing under SDL's dummy driver otherwise
        env.viewer.observer_vehicle = SimpleNamespace(position=0.5 * (low + high))
        picture = Image.fromarray(np.asarray(env.render(), np.uint8))
        _mark(picture, (np.array([each.position for each in env.road.vehicles]) - low) * scaling)
    finally:
        env.close()
    path.parent.mkdir(parents=True, exist_ok=True)
    picture.quantize(64, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


def _mark(picture: Image.Image, places: FloatArray) -> None:
    """Draw a dot over each vehicle, the ego first, because bodies are hardly visible at this scale."""
    pen = ImageDraw.Draw(picture)
    for i, (x, y) in reversed(list(enumerate(places))):
        pen.ellipse((x - _DOT, y - _DOT, x + _DOT, y + _DOT), fill=_EGO if i == 0 else _OTHER)
