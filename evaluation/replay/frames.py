"""The frames of a replay, from the recorded states and the decisions about them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import nan
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.roads.straight import Road
from dynamics.scenes.scene import Scene
from dynamics.state import FloatArray, State
from evaluation.measuring.recorder import Track
from evaluation.replay.record import STEP, TURN, ReplayFrame, rounded
from evaluation.report.draw import WorldFrame, acting_decision, status_of
from shield.decision import Decision, Tier
from shield.explaining.roads import NetworkDecisionData
from shield.pipelines.decide import DecisionData

if TYPE_CHECKING:
    from evaluation.replay.collect import RecordedStep

__all__ = ["frames_of"]

_VIEW = 120.0
"""Greatest distance from the ego of bodies in a frame [m]."""
_POINTS = 24
"""Approximate number of points of a plan."""


def frames_of(
    steps: Sequence[RecordedStep],
    world: FloatArray,
    columns: Mapping[Any, int],
    road: Road | WorldFrame,
    meta: bool,
    dt: float,
) -> list[ReplayFrame]:
    """Make one frame for each recorded state.

    Parameters
    ----------
    steps : steps of the episode.
    world : recorded states, (frames + 1, bodies, 8), columns `Track`.
    columns : index of each body in it.
    road : road of the frame of plans.
    meta : whether actions are meta-actions.
    dt : duration of a frame [s].
    """
    frames = []
    for number, seen in enumerate(steps):
        for age, inputs in enumerate(seen.inputs):
            at = seen.first + age
            about = seen.frames[age] if age < len(seen.frames) else None
            frames.append(_decided(number, seen, age, inputs, about, (world[at], columns, road, meta, dt * at)))
    for at in range(len(frames), len(world)):
        frames.append(_frame_without_decision(world[at], dt * at))
    return frames


def _decided(
    number: int,
    seen: RecordedStep,
    age: int,
    inputs: tuple[float, float],
    about: Decision | None,
    where: tuple[Any, ...],
) -> ReplayFrame:
    rows, columns, road, meta, time = where
    record = seen.record
    shown = record if about is None else about
    acting = acting_decision(record, about, meta)
    plan, first = (acting.plan, 0) if acting is about else (None, 0)
    if plan is None:
        plan, first = record.plan, age
    points, every = _points(plan, first, road)
    ego = rows[0]
    return ReplayFrame(
        time=time,
        x=float(ego[Track.S]),
        y=float(ego[Track.R]),
        heading=float(ego[Track.HEADING]),
        speed=float(ego[Track.SPEED]),
        step=number,
        status="OFF" if record.tier is Tier.OFF else status_of(record, about, meta),
        acceleration=inputs[0],
        wheel=inputs[1],
        tier=shown.tier.value,
        reason=shown.reason.value,
        margin=float(shown.margin),
        clause=shown.clause,
        binding=_binding(shown, columns),
        others=_others(rows),
        plan=points,
        every=every,
        until=max(1, len(seen.inputs) - age),
    )


def _frame_without_decision(rows: FloatArray, time: float) -> ReplayFrame:
    x, y, heading, speed = (float(value) for value in rows[0, : Track.LENGTH])
    return ReplayFrame(time, x, y, heading, speed, -1, "", nan, nan, "", "", nan, "", -1, _others(rows), [], 1, 0)


def _others(rows: FloatArray) -> list[int]:
    """Values of `ReplayFrame.others`."""
    near = np.hypot(*(rows[:, : State.Y + 1] - rows[0, : State.Y + 1]).T) < _VIEW
    near[0] = False
    there = np.flatnonzero(near & (rows[:, Track.LENGTH] > 0))
    states = rows[there, : Track.LENGTH] / (STEP, STEP, TURN, STEP)
    return rounded(np.column_stack([there, states]), 1.0)


def _points(plan: FloatArray | None, first: int, road: Road | WorldFrame) -> tuple[list[int], int]:
    """Points of a plan from a frame on, and the number of frames from one to the next."""
    if plan is None or len(plan) <= first + 1:
        return [], 1
    left = len(plan) - first
    every = max(1, -(-left // _POINTS))
    at = [*range(first, len(plan) - 1, every), len(plan) - 1]
    return rounded(np.asarray(road.to_world(plan[at]))[:, : State.Y + 1]), every


def _binding(decision: Decision, columns: Mapping[Any, int]) -> int:
    """Index of the binding body of a decision; -1 if it is unknown."""
    source, row = decision.source, decision.vehicle
    if row < 0:
        return -1
    if isinstance(source, DecisionData) and isinstance(source.scene, Scene) and source.scene.bodies is not None:
        identities: Sequence[Any] = source.scene.bodies
    elif isinstance(source, NetworkDecisionData):
        identities = source.identities
    else:
        return -1
    return columns.get(identities[row], -1) if row < len(identities) else -1
