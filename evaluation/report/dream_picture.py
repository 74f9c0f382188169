"""A strip and a film of a dream: real frames, and the occupancy that was decoded or imagined."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from dynamics.world_model.birds_eye import composite
from dynamics.world_model.view import EGO, OTHERS, RELATIVE_SPEED
from evaluation.running.dreams import Dream
from shield.errors import ConfigError

__all__ = ["draw_dream", "dream_path", "film_dream"]

_SCALE, _GAP, _TITLE = 2, 4, 12
"""Size of a pixel of a frame, gap between pictures, and height of a title [pixels]."""
_BACKGROUND, _TEXT, _IMAGINED = (24, 24, 28), (230, 230, 230), (255, 170, 60)
_FRAME_TIME = 500
"""Duration of a picture in a film [ms]."""


def dream_path(path: str | Path, ending: str) -> Path:
    """The path, if its ending is as given.

    Raises
    ------
    ConfigError
        If not.
    """
    path = Path(path)
    if path.suffix != ending:
        raise ConfigError(f"{path.name!r} must end in {ending}")
    return path


def draw_dream(dream: Dream, path: str | Path) -> Path:
    """Write a strip, .png: a column for each decision, the real frame above, the decoded occupancy below."""
    path = dream_path(path, ".png")
    columns = [_column(dream, t) for t in range(len(dream.frames))]
    width = sum(each.width + _GAP for each in columns) - _GAP
    strip = Image.new("RGB", (width, columns[0].height), _BACKGROUND)
    for t, each in enumerate(columns):
        strip.paste(each, (t * (each.width + _GAP), 0))
    path.parent.mkdir(parents=True, exist_ok=True)
    strip.save(path)
    return path


def film_dream(dream: Dream, path: str | Path) -> Path:
    """Write a film, .gif: the columns of the strip one after the other."""
    path = dream_path(path, ".gif")
    first, *others = (_column(dream, t) for t in range(len(dream.frames)))
    path.parent.mkdir(parents=True, exist_ok=True)
    first.save(path, save_all=True, append_images=others, duration=_FRAME_TIME, loop=0)
    return path


def _column(dream: Dream, t: int) -> Image.Image:
    """Real frame and decoded occupancy of decision `t`, with titles."""
    real, decoded = _enlarged(composite(dream.frames[t])), _enlarged(_decoded(dream, t))
    seen = t < dream.context
    column = Image.new("RGB", (real.width, 2 * (real.height + _TITLE) + _GAP), _BACKGROUND)
    write = ImageDraw.Draw(column)
    write.text((2, 0), f"real {t}", fill=_TEXT)
    column.paste(real, (0, _TITLE))
    below = _TITLE + real.height + _GAP
    title = f"decoded {t}" if seen else f"imagined +{t - dream.context + 1}"
    write.text((2, below), title, fill=_TEXT if seen else _IMAGINED)
    column.paste(decoded, (0, below + _TITLE))
    return column


def _decoded(dream: Dream, t: int) -> NDArray[np.uint8]:
    """Colour picture of the decoded occupancy, with the ego of the last seen frame."""
    frame = np.zeros_like(dream.frames[0])
    size, grid = frame.shape[-1], dream.occupancy[t]
    frame[EGO] = dream.frames[min(t, dream.context - 1), EGO]
    cells = np.repeat(np.repeat(grid, size // grid.shape[0], 0), size // grid.shape[1], 1)
    frame[OTHERS] = (255 * cells + 0.5).astype(np.uint8)
    frame[RELATIVE_SPEED] = 128
    return composite(frame)


def _enlarged(picture: NDArray[np.uint8]) -> Image.Image:
    """The picture with larger pixels."""
    return Image.fromarray(np.repeat(np.repeat(picture, _SCALE, 0), _SCALE, 1))
