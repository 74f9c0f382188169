"""Picture of a decision: highway-env's own drawing, with an overlay of the shield's prediction and decision.

- Solid line: the ego's path until the next decision. It is green for a passed proposal, orange for a changed one, and
  red for a fallback.
- Dotted line: the fail-safe in reserve, with the time at its end. It is executed only if no better plan verifies by
  then, and the other vehicles move on in the meantime.
- Dashed yellow line: the proposal, if another plan is executed.
- Shaded areas: reachable intervals of the other vehicles within the next second, fainter at later times.

In simulated traffic the dotted line is the rest of the plan, and the areas are the predicted positions of the others.
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
from shield.decision import Decision, Intervention, Reason

__all__ = [
    "AHEAD",
    "AREA",
    "GREEN",
    "ORANGE",
    "PROPOSAL",
    "RED",
    "Shot",
    "WorldFrame",
    "acting_decision",
    "draw",
    "font",
    "status_of",
    "without_decision",
]

GREEN, ORANGE, RED = (46, 160, 67), (240, 136, 30), (215, 45, 45)
AREA, PROPOSAL = (150, 75, 235), (255, 214, 10)
_INK, _PALE, _PAPER = (30, 34, 40), (110, 116, 125), (250, 250, 248)
_BAR = 112
"""Height of the caption [px]."""
_OVERSAMPLING = 2
_LINES = 2
"""Number of lines of the caption for the explanation."""
_OUTLINES = 0.25
"""Time between two outlines of the ego along its path [s]."""
AHEAD = (1.0, 2 / 3, 1 / 3, 0.0)
"""Times ahead at which the areas are drawn [s]; the last is drawn on top."""
_UNVERIFIED = "nothing was found that begins with it and keeps the buffer, the others as they are simulated"
"""Text of `Reason.UNVERIFIED` for simulated traffic, which has no assumptions."""


class WorldFrame:
    """Stands in for a road if plans and areas are in the world frame already."""

    def to_world(self, states: FloatArray) -> FloatArray:
        """The same states, (..., 4)."""
        return states

    def to_road(self, states: FloatArray) -> FloatArray:
        """The same states, (..., 4)."""
        return states


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A simulation frame before it is executed, and its decision.

    Attributes
    ----------
    image : highway-env's picture, (height, width, 3) uint8.
    origin, scaling : world position of the upper left pixel [m], and pixels per metre.
    road : road of the frame of plans and areas.
    dt : duration of a simulation frame [s].
    time, speed : time since reset [s], and the ego's speed [m/s].
    size : length and width of the ego [m].
    actions : label of each action index; empty for throttle and steering.
    decision, frame : record of the step, and decision about this frame (None in modes without).
    age : number of frames since `decision` was made.
    period : number of frames from one decision to the next.
    proposal : road states (period + 1, 4) of the proposal from the decision on, or None.
    simulated : whether the traffic is simulated, so that plan and areas are predictions and not bounds.
    areas : reachable areas of the others on a road network, at each of the times `AHEAD`: outlines (n, 2) in the frame
        of `road` [m]. Without them the decision's `occupancy` is drawn.
    words : explanation of a refused proposal (`Decision.explain`); "" otherwise.
    """

    image: NDArray[np.uint8]
    origin: tuple[float, float]
    scaling: float
    road: Road | WorldFrame
    dt: float
    time: float
    speed: float
    size: tuple[float, float]
    actions: tuple[str, ...]
    decision: Decision
    frame: Decision | None
    age: int
    period: int
    proposal: FloatArray | None = None
    simulated: bool = False
    areas: tuple[tuple[FloatArray, ...], ...] = ()
    words: str = ""

    @property
    def acting(self) -> Decision:
        """The decision that determines this frame, see `acting_decision`."""
        return acting_decision(self.decision, self.frame, bool(self.actions))

    @property
    def status(self) -> str:
        """Status of this frame, see `status_of`."""
        return status_of(self.decision, self.frame, bool(self.actions))

    @property
    def color(self) -> tuple[int, int, int]:
        """Colour of the status: green for passed, orange for overridden or held back, red for a fallback."""
        return {"PASSED": GREEN, "FALLBACK": RED}.get(self.status, ORANGE)


def acting_decision(decision: Decision, frame: Decision | None, meta: bool) -> Decision:
    """The decision that determines a frame.

    It is the decision about the action if another action was executed, else the decision about the frame.

    Parameters
    ----------
    decision : record of the step.
    frame : decision about the frame; None in modes without.
    meta : whether actions are meta-actions.
    """
    if frame is None or (_other_action(decision, frame, meta) and not frame.overridden):
        return decision
    return frame


def status_of(decision: Decision, frame: Decision | None, meta: bool) -> str:
    """Status of a frame.

    Parameters are those of `acting_decision`.

    Returns
    -------
    "PASSED"; "HELD BACK" for the proposed action with other inputs in this frame; "OVERRIDE" for another action; or
    "FALLBACK".
    """
    acting = acting_decision(decision, frame, meta)
    if (acting if frame is None else frame).tier.fallback:
        return "FALLBACK"
    if _other_action(decision, frame, meta):
        return "OVERRIDE"
    return "HELD BACK" if acting.overridden else "PASSED"


def _other_action(decision: Decision, frame: Decision | None, meta: bool) -> bool:
    """Whether another action holds for the whole step; throttle and steering are decided frame by frame."""
    return decision.intervention is Intervention.OTHER_ACTION and (meta or frame is None)


def draw(shot: Shot) -> Image.Image:
    """Draw the picture of a shot, with its caption."""
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


def without_decision(image: NDArray[np.uint8]) -> Image.Image:
    """A picture of the same size without a decision."""
    height, width, _ = image.shape
    canvas = Image.new("RGB", (width, height + _BAR), _PAPER)
    canvas.paste(Image.fromarray(image), (0, 0))
    return canvas


def _pixels(shot: Shot, points: FloatArray) -> list[tuple[float, float]]:
    """Convert road positions (n, 2) [m] to pixels of the oversampled overlay."""
    states = np.zeros((len(points), 4))
    states[:, : RoadState.R + 1] = points
    world = shot.road.to_world(states)[:, : State.Y + 1]
    pixels = (world - shot.origin) * shot.scaling * _OVERSAMPLING
    return [(float(x), float(y)) for x, y in pixels]


def _draw_areas(overlay: Image.Image, shot: Shot) -> None:
    """Draw the reachable areas of the others from this frame on."""
    for rank, outlines in enumerate(shot.areas or _rectangles(shot)):
        layer = Image.new("RGBA", overlay.size, (0, 0, 0, 0))
        pen = ImageDraw.Draw(layer)
        for outline in outlines:
            pen.polygon(_pixels(shot, outline), fill=(*AREA, 70 + 20 * rank))
        overlay.alpha_composite(layer)


def _rectangles(shot: Shot) -> list[list[FloatArray]]:
    """Occupancy of the decision at each drawn time, as outlines (4, 2)."""
    areas = shot.decision.occupancy
    if areas is None:
        return []
    steps = [shot.age + round(ahead / shot.dt) for ahead in AHEAD]
    return [
        [
            np.array([(s_min, r_min), (s_max, r_min), (s_max, r_max), (s_min, r_max)])
            for s_min, s_max, r_min, r_max in (areas[step] if step < len(areas) else ())
            if s_max > s_min and r_max > r_min
        ]
        for step in steps
    ]


def _draw_plan(overlay: Image.Image, shot: Shot) -> None:
    """Draw the ego's path, its footprint every quarter of a second until the next decision, and the proposal's path."""
    plan, first = (shot.acting.plan, 0) if shot.acting is shot.frame else (None, 0)
    if plan is None:
        plan, first = shot.decision.plan, shot.age
    if plan is None or len(plan) <= first:
        return
    plan = plan[first:]
    pen = ImageDraw.Draw(overlay)
    until = min(max(shot.period - shot.age, 1), len(plan) - 1)
    for step in range(0, until + 1, max(1, round(_OUTLINES / shot.dt))):
        _draw_outline(pen, shot, plan[step], (*shot.color, 150))
    path = _pixels(shot, plan[:, : RoadState.R + 1])
    if shot.proposal is not None and shot.status != "PASSED" and shot.age < shot.period:
        ahead = _pixels(shot, shot.proposal[shot.age :, : RoadState.R + 1])
        _draw_dashes(pen, ahead, (*PROPOSAL, 255), 3 * _OVERSAMPLING, dash=9 * _OVERSAMPLING)
        _draw_outline(pen, shot, shot.proposal[-1], (*PROPOSAL, 230))
    _draw_dashes(pen, path[until:], (*shot.color, 230), 2 * _OVERSAMPLING, dash=3 * _OVERSAMPLING)
    pen.line(path[: until + 1], fill=(*shot.color, 255), width=3 * _OVERSAMPLING, joint="curve")
    _draw_outline(pen, shot, plan[-1], (*shot.color, 230))
    x, y = path[-1]
    half = shot.size[0] / 2 * shot.scaling * _OVERSAMPLING
    time = f"{shot.dt * (len(plan) - 1):.1f} s"
    pen.text((x + half + 8, y), time, font=font(11 * _OVERSAMPLING), fill=(*_PAPER, 255), anchor="lm")


def _draw_outline(pen: ImageDraw.ImageDraw, shot: Shot, state: FloatArray, fill: tuple[int, ...]) -> None:
    """Draw the ego's footprint at a road state."""
    length, width = shot.size
    box = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * (length / 2, width / 2)
    heading = state[RoadState.HEADING]
    turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    pen.line(_pixels(shot, box @ turn + state[: RoadState.R + 1]), fill=fill, width=_OVERSAMPLING)


def _draw_dashes(
    pen: ImageDraw.ImageDraw, path: list[tuple[float, float]], fill: tuple[int, ...], width: int, dash: float
) -> None:
    """Draw a line of dashes, as long as the gaps between them."""
    if len(path) < 2:
        return
    points = np.array(path)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    for start in np.arange(0.0, way[-1], 2 * dash):
        at = np.linspace(start, min(start + dash, way[-1]), 4)
        xs, ys = np.interp(at, way, points[:, 0]), np.interp(at, way, points[:, 1])
        pen.line([(float(x), float(y)) for x, y in zip(xs, ys, strict=True)], fill=fill, width=width)


@lru_cache(maxsize=8)
def font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """The typeface of all captions; `size` in pixels."""
    weight = "bold" if bold else "normal"
    path = font_manager.findfont(font_manager.FontProperties(family="DejaVu Sans", weight=weight))
    return ImageFont.truetype(path, size)


def _label(shot: Shot, action: Any) -> str:
    if not shot.actions:
        values = np.ravel(action)
        if values.dtype.kind in "iu":
            return "number " + ", ".join(map(str, values))
        # Throttle and steering as shares of their ranges, in the units of the policy.
        return (", ".join(f"{x:+.2f}" for x in values) + " of ±1").replace("-", "−")
    try:
        return shot.actions[int(action)]
    except (TypeError, ValueError, IndexError):
        return str(action)


def _executed(shot: Shot) -> str:
    """Text of the executed action, with the inputs that replaced it if the frame was held back."""
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
    pen.rectangle((0, top, 10, top + _BAR), fill=shot.color)
    x, y = 24, top + 10
    pen.text((x, y + 2), shot.status, font=font(21, bold=True), fill=shot.color)
    for heading, text, left, bold in (
        ("proposed", _label(shot, shot.decision.proposed), 170, False),
        ("executed", _executed(shot), 360, shot.status != "PASSED"),
        ("margin", _metres(acting.margin), width - 330, False),
        ("speed", f"{shot.speed:.1f} m/s", width - 215, False),
        ("time", f"{shot.time:.1f} s", width - 90, False),
    ):
        pen.text((left, y - 3), heading, font=font(12), fill=_PALE)
        pen.text((left, y + 12), text, font=font(18, bold=bold), fill=_INK)
    words = shot.words
    if shot.status == "PASSED" or not words:
        words = f"{acting.reason.value}: {_text(shot, acting.reason)}"
    for line, text in enumerate(_lines(pen, words, width - 2 * x)):
        pen.text((x, y + 43 + 15 * line), text, font=font(12), fill=_INK)
    _draw_legend(pen, shot, width, y + 76)


def _lines(pen: ImageDraw.ImageDraw, text: str, width: int) -> list[str]:
    """Break a text into at most two lines of `width` pixels, and cut off the rest."""
    lines: list[str] = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if pen.textlength(longer, font=font(12)) <= width:
            lines[-1] = longer
        elif len(lines) < _LINES:
            lines.append(word)
        else:
            lines[-1] = f"{lines[-1]} …"
            break
    return lines


def _text(shot: Shot, reason: Reason) -> str:
    return _UNVERIFIED if shot.simulated and reason is Reason.UNVERIFIED else reason.text


def _draw_legend(pen: ImageDraw.ImageDraw, shot: Shot, width: int, y: int) -> None:
    """Draw the legend of colours and lines, from the right."""
    right, small = width - 16, font(12)
    for text, colors, dash in (
        ("others, foretold for 1 s" if shot.simulated else "others within 1 s", (AREA,), 0),
        ("planned to go on" if shot.simulated else "fail-safe in reserve", (_PALE,), 3),
        ("proposed", (PROPOSAL,), 7),
        ("executed: passed, overridden or held back, fallback", (GREEN, ORANGE, RED), 0),
    ):
        left = right - pen.textlength(text, font=small)
        pen.text((left, y + 2), text, font=small, fill=_PALE)
        for color in reversed(colors):
            left -= 18
            if dash:
                line = [(left - 8, y + 9.0), (left + 12, y + 9.0)]
                _draw_dashes(pen, line, color, 3, dash)
                left -= 8
            else:
                pen.rectangle((left, y + 4, left + 12, y + 14), fill=color)
        right = round(left - 14)


def _metres(margin: float) -> str:
    return f"{margin:.2f} m" if np.isfinite(margin) else "–"
