"""The record of one episode that a replay page shows, and its JSON.

Numbers of the shield and of the ego are written so that they are read back bit for bit. What is only drawn (bodies of
the others, plans, areas, lanes) is rounded to `STEP` metres and `TURN` radians, and written as whole numbers of these.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dynamics.state import FloatArray

__all__ = [
    "STEP",
    "TURN",
    "Area",
    "Body",
    "Frame",
    "LaneDrawn",
    "Override",
    "Replay",
    "Step",
    "WhatIf",
    "poses",
    "rounded",
]

STEP, TURN = 0.01, 0.0001
"""What drawn lengths [m] and drawn angles [rad] are rounded to."""
FORMAT = 1
"""Version of the JSON."""


@dataclass(frozen=True, slots=True)
class LaneDrawn:
    """A lane in the world.

    Attributes
    ----------
    left, right : its edges, x and y one after another, in units of `STEP`. lines : highway-env's type of each edge, 0
        for none, 1 for dashes, else drawn through.
    """

    left: list[int]
    right: list[int]
    lines: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Body:
    """A vehicle or an obstacle: name of its class, length and width [m]. The first is the ego."""

    kind: str
    length: float
    width: float


@dataclass(frozen=True, slots=True)
class Area:
    """Where one of the others can be: its body, -1 where that is not known, and an outline in units of `STEP`."""

    body: int
    outline: list[int]


@dataclass(frozen=True, slots=True)
class Frame:
    """One simulation frame, before it is played; the last of an episode has no decision.

    Attributes
    ----------
    time : since reset [s]. x, y, heading, speed : of the ego in the world [m], [rad], [m/s].
    step : number of the decision that it belongs to, -1 without one.
    status : "PASSED", "HELD BACK", "OVERRIDE", "FALLBACK", "OFF"; "" without a decision.
    acceleration, wheel : what the ego's actuators got in this frame [m/s^2], [rad]; NaN without a decision.
    tier, reason, margin, clause : of the decision about this frame, or of the step where frames are not decided about;
        the margin [m].
    binding : body that the margin is about, -1 where that is not known.
    others : of each other body in view: its number, x, y, heading, and speed in units of `STEP`, one after another.
    plan : places of the ego on its plan from this frame on, x and y one after another, one every `every` frames and the
        last; `until` is the number of frames until the next decision.
    """

    time: float
    x: float
    y: float
    heading: float
    speed: float
    step: int
    status: str
    acceleration: float
    wheel: float
    tier: str
    reason: str
    margin: float
    clause: str
    binding: int
    others: list[int]
    plan: list[int]
    every: int
    until: int


@dataclass(frozen=True, slots=True)
class Step:
    """The record of one step, `shield.decision.Decision` in words.

    Attributes
    ----------
    first : its first frame. overridden, frames_overridden, margin, latency : of the record.
    text : what `Decision.explain` says.
    """

    first: int
    proposed: str
    executed: str
    tier: str
    reason: str
    intervention: str
    guarantee: str
    overridden: bool
    fallback: bool
    frames_overridden: int
    margin: float
    latency: float
    text: str


@dataclass(frozen=True, slots=True)
class WhatIf:
    """What the simulator makes of a proposal that is let through.

    Attributes
    ----------
    then : what drives after the proposal, in words. text : what comes of it, in words.
    crashed, off_road : whether the ego crashes or leaves the road. time : of the crash, else of the smallest gap, from
        the decision on [s].
    gap : the smallest clearance to another body [m], 0 in a crash. within : whether one comes within the buffer.
    body : which one comes nearest, -1 for none.
    path : x, y and heading of the ego at the decision and after each frame, one after another; near : the same of the
        nearest body.
    """

    then: str
    text: str
    crashed: bool
    off_road: bool
    time: float
    gap: float
    within: bool
    body: int
    path: list[int]
    near: list[int]


@dataclass(frozen=True, slots=True)
class Override:
    """A step in which the proposal was refused: its explanation in parts (`shield.explanation.Explanation`).

    Attributes
    ----------
    step : its number. frame : the frame at which the proposal was refused.
    cause : body that is the cause, -1 without one. binding : time from that frame on at which the buffer would be
        short [s], NaN where it is not known.
    areas : where the others can be then; `what_if` is None where it was not asked.
    """

    step: int
    frame: int
    refused: str
    clause: str
    why: str
    done: str
    proof: str
    text: str
    short: float
    binding: float
    cause: int
    areas: list[Area]
    what_if: WhatIf | None


@dataclass(frozen=True, slots=True)
class Replay:
    """One episode.

    Attributes
    ----------
    about : what was driven and what came of it, by name. buffer : along and across the ego [m].
    dt : between two frames [s]. straight : whether the road is one of parallel straight lanes.
    """

    about: dict[str, Any]
    buffer: tuple[float, float]
    dt: float
    straight: bool
    lanes: list[LaneDrawn]
    bodies: list[Body]
    frames: list[Frame]
    steps: list[Step]
    overrides: list[Override]

    def to_json(self) -> str:
        """JSON: objects as the classes here; a number that is not finite is the text "NaN", "Infinity" or
        "-Infinity"."""
        data = {"format": FORMAT, "unit": STEP, "turn": TURN, **_plain(self)}
        return json.dumps(data, separators=(",", ":"), allow_nan=False, ensure_ascii=False)


def rounded(values: ArrayLike, unit: float = STEP) -> list[int]:
    """Numbers as whole numbers of a unit, in one list."""
    return [int(x) for x in np.rint(np.asarray(values, dtype=float).ravel() / unit)]


def poses(states: FloatArray) -> list[int]:
    """x, y [m] and heading [rad] of states (n, 3 or more), in their units."""
    return rounded(np.asarray(states)[:, :3] / (STEP, STEP, TURN), 1.0)


def _plain(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, dict):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return value if value and all(type(each) is int for each in value) else [_plain(each) for each in value]
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    return value
