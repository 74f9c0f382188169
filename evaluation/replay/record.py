"""The data of a replay page, and its JSON.

Numbers of the shield and of the ego keep their exact values in JSON. Values that are only drawn (bodies of the others,
plans, areas, lanes) are rounded to `STEP` metres and `TURN` radians, and stored as multiples of these.
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
    "LaneDrawn",
    "Replay",
    "ReplayArea",
    "ReplayBody",
    "ReplayFrame",
    "ReplayOverride",
    "ReplayStep",
    "WhatIf",
    "poses",
    "rounded",
]

STEP, TURN = 0.01, 0.0001
"""Resolution of drawn lengths [m] and drawn angles [rad]."""
FORMAT = 1
"""Version of the JSON."""


@dataclass(frozen=True, slots=True)
class LaneDrawn:
    """A lane in the world frame.

    Attributes
    ----------
    left, right : its edges, alternating x and y, in units of `STEP`.
    lines : highway-env's type of each edge: 0 for none, 1 for dashes, else solid.
    """

    left: list[int]
    right: list[int]
    lines: tuple[int, int]


@dataclass(frozen=True, slots=True)
class ReplayBody:
    """A vehicle or an obstacle: name of its class, length and width [m]. The first body is the ego."""

    kind: str
    length: float
    width: float


@dataclass(frozen=True, slots=True)
class ReplayArea:
    """Reachable area of another vehicle: index of its body, -1 if unknown, and an outline in units of `STEP`."""

    body: int
    outline: list[int]


@dataclass(frozen=True, slots=True)
class ReplayFrame:
    """One simulation frame before it is executed; the last frame of an episode has no decision.

    Attributes
    ----------
    time : time since reset [s].
    x, y, heading, speed : state of the ego in the world frame [m], [rad], [m/s].
    step : index of the decision that the frame belongs to; -1 without one.
    status : "PASSED", "HELD BACK", "OVERRIDE", "FALLBACK", "OFF"; "" without a decision.
    acceleration, wheel : inputs of the ego's actuators in this frame [m/s^2], [rad]; NaN without a decision.
    tier, reason, margin, clause : values of the decision about this frame, or of the step if frames have no decisions;
        the margin [m].
    binding : index of the binding body; -1 if unknown.
    others : for each other body in view its index, x, y, heading and speed, in units of `STEP` and `TURN`.
    plan : points of the ego's plan from this frame on, alternating x and y, in units of `STEP`.
    every : number of frames from one point of the plan to the next; the last point may be nearer.
    until : number of frames until the next decision.
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
class ReplayStep:
    """Record of one step, `shield.decision.Decision` in words.

    Attributes
    ----------
    first : index of its first frame.
    proposed, executed : names of the actions.
    tier, reason, intervention, guarantee, overridden, frames_overridden, margin, latency : values of the record.
    fallback : whether the tier is a fallback.
    text : text of `Decision.explain`.
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
    """Simulation of a refused proposal.

    Attributes
    ----------
    then : what drives after the proposal, in words.
    text : the result, in words.
    crashed, off_road : whether the ego crashes or leaves the road.
    time : time of the crash, else of the least gap, from the decision on [s].
    gap : least clearance to another body [m], 0 in a crash.
    within : whether a body comes within the buffer.
    body : index of the nearest body, -1 for none.
    path : x, y and heading of the ego at the decision and after each frame, in units of `STEP` and `TURN`.
    near : the same for the nearest body.
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
class ReplayOverride:
    """A step with a refused proposal: its explanation in parts (`shield.explanation.Explanation`).

    Attributes
    ----------
    step : index of the step.
    frame : frame in which the proposal was refused.
    refused, clause, why, done, proof, text, short : parts of the explanation.
    binding : time from that frame on at which the buffer would be short [s]; NaN if unknown.
    cause : index of the body that is the cause; -1 without one.
    areas : reachable areas of the others at that time.
    what_if : simulation of the proposal; None if there is none.
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
    areas: list[ReplayArea]
    what_if: WhatIf | None


@dataclass(frozen=True, slots=True)
class Replay:
    """One episode.

    Attributes
    ----------
    about : specification and results of the episode, by name.
    buffer : buffer along and across the ego [m].
    dt : time between two frames [s].
    straight : whether the road has parallel straight lanes.
    lanes, bodies, frames, steps, overrides : contents of the replay.
    """

    about: dict[str, Any]
    buffer: tuple[float, float]
    dt: float
    straight: bool
    lanes: list[LaneDrawn]
    bodies: list[ReplayBody]
    frames: list[ReplayFrame]
    steps: list[ReplayStep]
    overrides: list[ReplayOverride]

    def to_json(self) -> str:
        """The replay as JSON, with objects like the classes here.

        Numbers that are not finite are the texts "NaN", "Infinity" and "-Infinity".
        """
        data = {"format": FORMAT, "unit": STEP, "turn": TURN, **_plain(self)}
        return json.dumps(data, separators=(",", ":"), allow_nan=False, ensure_ascii=False)


def rounded(values: ArrayLike, unit: float = STEP) -> list[int]:
    """Numbers as multiples of a unit, rounded to integers, in one list."""
    return [int(x) for x in np.rint(np.asarray(values, dtype=float).ravel() / unit)]


def poses(states: FloatArray) -> list[int]:
    """x, y [m] and heading [rad] of states (n, 3 or more), in units of `STEP` and `TURN`."""
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
