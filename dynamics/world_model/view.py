"""Part of the scene that a bird's-eye frame shows, and its channels."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Any, NamedTuple

from dynamics.errors import ConfigError

__all__ = ["CHANNELS", "DRIVABLE", "EGO", "MARKINGS", "OTHERS", "RELATIVE_SPEED", "FrameView", "ViewNumbers"]

CHANNELS = ("drivable", "markings", "ego", "others", "relative_speed")
"""Channels of a frame, in order."""
DRIVABLE, MARKINGS, EGO, OTHERS, RELATIVE_SPEED = range(len(CHANNELS))

_SMALLEST, _LARGEST = 16, 512
"""Bounds of the number of rows and columns."""


class ViewNumbers(NamedTuple):
    """A `FrameView` for the kernels.

    Attributes
    ----------
    behind, side : distances of the first column and the first row from the ego [m].
    length, width : of a pixel [m].
    top_speed, relative_speed : speeds of the brightest pixels [m/s].
    """

    behind: float
    side: float
    length: float
    width: float
    top_speed: float
    relative_speed: float


@dataclass(frozen=True)
class FrameView:
    """Rectangle around the ego, aligned with its heading, that a frame shows.

    A frame has shape (5, size, size), uint8, in the order of `CHANNELS`. Columns run from `behind` the ego to `ahead`
    of it; rows from its left to its right. Edges are soft: a pixel has the share of its area that is covered, times
    255.

    - *drivable*: the area of the lanes.
    - *markings*: lines beside the lanes; dashed ones half as bright.
    - *ego*: the ego's footprint; from a quarter of the brightness at 0 m/s to all of it at `top_speed`.
    - *others*: footprints of other vehicles and of obstacles.
    - *relative_speed*: where others are, 128 for the ego's speed; 1 and 255 for `relative_speed` slower and faster,
      along the ego's heading.

    Parameters
    ----------
    ahead, behind : distances along the ego's heading [m].
    side : distance to either side [m].
    size : number of rows and of columns, 16 to 512.
    top_speed, relative_speed : speeds of the brightest pixels [m/s].

    Raises
    ------
    ConfigError
        If a distance or a speed is not positive and finite, or the size is outside of its bounds.

    Examples
    --------
    >>> FrameView().shape
    (5, 64, 64)
    """

    ahead: float = 100.0
    behind: float = 28.0
    side: float = 16.0
    size: int = 64
    top_speed: float = 40.0
    relative_speed: float = 20.0

    def __post_init__(self) -> None:
        for name in ("ahead", "behind", "side", "top_speed", "relative_speed"):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise ConfigError(f"{name} of a frame is a positive number, not {value!r}")
        size: Any = self.size
        if not isinstance(size, int) or not _SMALLEST <= size <= _LARGEST:
            raise ConfigError(f"size of a frame is an integer from {_SMALLEST} to {_LARGEST}, not {self.size!r}")

    @property
    def shape(self) -> tuple[int, int, int]:
        """Channels, rows and columns."""
        return len(CHANNELS), self.size, self.size

    @property
    def numbers(self) -> ViewNumbers:
        """The same for the kernels."""
        length, width = (self.ahead + self.behind) / self.size, 2 * self.side / self.size
        return ViewNumbers(self.behind, self.side, length, width, self.top_speed, self.relative_speed)
