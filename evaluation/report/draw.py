"""One picture of a decision: highway-env's own drawing, and over it what the shield saw and did.

The ego's verified path is green while the proposal passes, orange where the shield changed it, red
where a fallback acts. The shaded areas are where the others can be within the next second, the
later the fainter.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from matplotlib import font_manager
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from dynamics.roads.straight import Road
from dynamics.state import FloatArray, RoadState, State
from shield.decision import Decision, Tier

__all__ = ["AREA", "GREEN", "ORANGE", "RED", "Shot", "draw"]

GREEN, ORANGE, RED = (46, 160, 67), (240, 136, 30), (215, 45, 45)
AREA = (150, 75, 235)
_INK, _PALE, _PAPER = (30, 34, 40), (110, 116, 125), (250, 250, 248)
_BAR = 92
"""Height of the caption [px]."""
_OVERSAMPLING = 2
_OUTLINES = 0.25
"""Time between two outlines of the ego along its path [s]."""
_AHEAD = (1.0, 2 / 3, 1 / 3, 0.0)
"""Times ahead at which the areas are drawn [s], the last on top."""


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A simulation frame, before it is played, and the decision about it.

    Attributes
    ----------
    image : highway-env's picture, (height, width, 3) uint8.
    origin, scaling : world position of the upper left pixel [m], and pixels per metre.
    road : the road that plans and areas refer to.
    dt : duration of a simulation frame [s].
    time, speed : time since reset [s], and the ego's speed [m/s].
    size : the ego's length and width [m].
    actions : label of each action index; none where actions are throttle and steering.
    decision, frame : the decision about the action, and about this frame (None in modes without).
    age : frames since `decision` was made.
    """

    image: NDArray[np.uint8]
    origin: tuple[float, float]
    scaling: float
    road: Road
    dt: float
    time: float
    speed: float
    size: tuple[float, float]
    actions: tuple[str, ...]
    decision: Decision
    frame: Decision | None
    age: int

    @property
    def acting(self) -> Decision:
        """The decision that this frame is driven by.

        It is that about the action where another action was taken, else that about the frame.
        """
        other = self.decision.overridden and self.decision.tier is not Tier.GOVERNED
        if self.frame is None or (other and not self.frame.overridden):
            return self.decision
        return self.frame

    @property
    def color(self) -> tuple[int, int, int]:
        """Green, orange or red: passed, overridden, fallback."""
        if self.acting.tier.fallback:
            return RED
        return ORANGE if self.acting.overridden else GREEN


def draw(shot: Shot) -> Image.Image:
    """The finished picture."""
    height, width, _ = shot.image.shape
    canvas = Image.new("RGB", (width, height + _BAR), _PAPER)
    base = Image.fromarray(shot.image).convert("RGBA")
    overlay = Image.new("RGBA", (width * _OVERSAMPLING, height * _OVERSAMPLING), (0, 0, 0, 0))
    _draw_areas(overlay, shot)
    _draw_plan(overlay, shot)
    overlay = overlay.resize((width, height), Image.Resampling.LANCZOS)
    canvas.paste(Image.alpha_composite(base, overlay).convert("RGB"), (0, 0))
    _draw_caption(ImageDraw.Draw(canvas), shot, height, width)
    return canvas


def _pixels(shot: Shot, points: FloatArray) -> list[tuple[float, float]]:
    """Road positions (n, 2) [m] to pixels of the oversampled overlay."""
    states = np.zeros((len(points), 4))
    states[:, : RoadState.R + 1] = points
    world = shot.road.to_world(states)[:, : State.Y + 1]
    pixels = (world - shot.origin) * shot.scaling * _OVERSAMPLING
    return [(float(x), float(y)) for x, y in pixels]


def _draw_areas(overlay: Image.Image, shot: Shot) -> None:
    """Where the others can be, from this frame on."""
    areas = shot.decision.occupancy
    if areas is None:
        return
    for rank, ahead in enumerate(_AHEAD):
        step = shot.age + round(ahead / shot.dt)
        if step >= len(areas):
            continue
        layer = Image.new("RGBA", overlay.size, (0, 0, 0, 0))
        pen = ImageDraw.Draw(layer)
        for s_min, s_max, r_min, r_max in areas[step]:
            if not (s_max > s_min and r_max > r_min):
                continue
            corners = [(s_min, r_min), (s_max, r_min), (s_max, r_max), (s_min, r_max)]
            pen.polygon(_pixels(shot, np.array(corners)), fill=(*AREA, 70 + 20 * rank))
        overlay.alpha_composite(layer)


def _draw_plan(overlay: Image.Image, shot: Shot) -> None:
    """The ego's path as a line, and its footprint every quarter of a second."""
    plan, first = (shot.acting.plan, 0) if shot.acting is shot.frame else (None, 0)
    if plan is None:
        plan, first = shot.decision.plan, shot.age
    if plan is None or len(plan) <= first:
        return
    plan = plan[first:]
    pen = ImageDraw.Draw(overlay)
    length, width = shot.size
    box = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * (length / 2, width / 2)
    for step in range(0, len(plan), max(1, round(_OUTLINES / shot.dt))):
        heading = plan[step, RoadState.HEADING]
        turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
        outline = _pixels(shot, box @ turn + plan[step, : RoadState.R + 1])
        pen.line(outline, fill=(*shot.color, 150), width=_OVERSAMPLING)
    path = _pixels(shot, plan[:, : RoadState.R + 1])
    if len(path) > 1:
        pen.line(path, fill=(*shot.color, 255), width=3 * _OVERSAMPLING, joint="curve")
    x, y = path[-1]
    radius = 5 * _OVERSAMPLING
    pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=(*shot.color, 255))


@lru_cache(maxsize=8)
def _font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    weight = "bold" if bold else "normal"
    path = font_manager.findfont(font_manager.FontProperties(family="DejaVu Sans", weight=weight))
    return ImageFont.truetype(path, size)


def _label(shot: Shot, action: Any) -> str:
    if not shot.actions:
        return ", ".join(f"{x:+.2f}" for x in np.ravel(action)).replace("-", "−")
    try:
        return shot.actions[int(action)]
    except (TypeError, ValueError, IndexError):
        return str(action)


def _executed(shot: Shot) -> str:
    """What the ego does: the action, and what it was replaced with where the frame was held back."""
    if not shot.actions and shot.frame is not None and shot.frame.overridden:
        acceleration, wheel = np.ravel(shot.frame.executed)
        return f"{acceleration:+.1f} m/s², {np.degrees(wheel):+.1f}°".replace("-", "−")
    text = _label(shot, shot.decision.executed)
    if shot.frame is not None and shot.frame.overridden:
        acceleration = getattr(shot.frame.executed, "acceleration", None)
        if acceleration is not None:
            text += f", held at {acceleration:+.1f} m/s²".replace("-", "−")
    return text


def _draw_caption(pen: ImageDraw.ImageDraw, shot: Shot, top: int, width: int) -> None:
    acting = shot.acting
    status = "FALLBACK" if acting.tier.fallback else "OVERRIDE" if acting.overridden else "PASSED"
    pen.rectangle((0, top, 10, top + _BAR), fill=shot.color)
    x, y = 24, top + 10
    pen.text((x, y + 2), status, font=_font(21, bold=True), fill=shot.color)
    for heading, text, left, bold in (
        ("proposed", _label(shot, shot.decision.proposed), 170, False),
        ("executed", _executed(shot), 360, acting.overridden),
        ("margin", _metres(acting.margin), width - 330, False),
        ("speed", f"{shot.speed:.1f} m/s", width - 215, False),
        ("time", f"{shot.time:.1f} s", width - 90, False),
    ):
        pen.text((left, y - 3), heading, font=_font(12), fill=_PALE)
        pen.text((left, y + 12), text, font=_font(18, bold=bold), fill=_INK)
    both = shot.decision.overridden and acting.overridden
    reason = shot.decision.reason if both else acting.reason
    pen.text((x, y + 50), f"{reason.value}: {reason.text}", font=_font(14), fill=_INK)
    _draw_legend(pen, width, y + 50)


def _draw_legend(pen: ImageDraw.ImageDraw, width: int, y: int) -> None:
    right = width - 16
    for text, color in (
        ("others within 1 s", AREA),
        ("fallback", RED),
        ("overridden", ORANGE),
        ("verified path", GREEN),
    ):
        font = _font(12)
        left = right - pen.textlength(text, font=font)
        pen.text((left, y + 2), text, font=font, fill=_PALE)
        pen.rectangle((left - 18, y + 4, left - 6, y + 14), fill=color)
        right = round(left - 34)


def _metres(margin: float) -> str:
    return f"{margin:.2f} m" if np.isfinite(margin) else "–"
