"""Candidate manoeuvres of the ego on a road network, in the order in which they are tried."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from dynamics.road_networks.simulation.ego_manoeuvres import EgoManoeuvre
from dynamics.vehicle.bicycle import MAX_SPEED
from shield.decision import Tier

__all__ = ["COMMITTED", "TargetCommand", "candidates_of", "frames_of", "remainder_after_frame", "stopping"]

COMMITTED = 1e3
"""Deceleration that stands for highway-env's own speed controller, which has no limit [m/s^2]."""
_ON = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0)
"""Durations for which a candidate is continued after the coming frame before the ego brakes [s]."""
_SPEEDS = 8
"""Number of speeds, from the target speed of the decision down to 0, that are tried in its place."""
_STOP = 5.0
"""Time to brake to a standstill at the default braking, rounded up [s]."""
_GAIN = 5.0
"""Greatest speed above the present one that is tried in place of the target speed [m/s]."""


class TargetCommand(NamedTuple):
    """Target command of a decision: a lane, and a speed [m/s]."""

    lane: int
    speed: float


def frames_of(frequency: float, braking: float) -> int:
    """Upper bound on the number of frames of a candidate, at `frequency` frames a second, with a stop at `braking`
    [m/s^2]: a candidate that is not at rest by then would verify without its last metres."""
    return math.ceil((max(_ON) + max(_STOP, MAX_SPEED / braking)) * frequency)


def stopping(lane: int, braking: float) -> EgoManoeuvre:
    """Candidate that brakes at once in a lane, at `braking` [m/s^2]."""
    return EgoManoeuvre(lane, 0.0, COMMITTED, 0, 0, braking)


def remainder_after_frame(manoeuvre: EgoManoeuvre, bound: int) -> EgoManoeuvre:
    """Remainder of a candidate after a frame, in which the ego's target lane has become `bound`."""
    aside = 0 if manoeuvre.frames < 1 else manoeuvre.aside
    return manoeuvre._replace(lane=bound, frames=max(manoeuvre.frames - 1, 0), aside=aside)


def candidates_of(
    command: TargetCommand,
    stored: EgoManoeuvre | None,
    speed: float,
    bound: Sequence[int],
    several: bool,
    frequency: float,
    braking: float,
) -> Iterator[tuple[EgoManoeuvre, Tier]]:
    """Candidates in order, each with its tier if it is clear: the target command first, then those close to it.

    Parameters
    ----------
    command : target command of the decision. stored : remainder of the candidate verified a frame before, if any.
    speed : of the ego now [m/s]. bound : target lane of the ego, and the lanes that it may keep to instead.
    several : whether the target lane belongs to a road of several lanes, so that the ego can move aside.
    frequency : frames per second [Hz]. braking : deceleration of the fail-safe [m/s^2].
    """
    frames = [1 + round(seconds * frequency) for seconds in _ON]
    if stored is not None and stored[:3] == (*command, COMMITTED) and stored.frames >= 1:
        yield stored, Tier.PASSED
    for aside in (0, -1, 1) if several else (0,):
        for n in frames:
            yield EgoManoeuvre(command.lane, command.speed, COMMITTED, n, aside, braking), Tier.PASSED
    top = max(min(command.speed, speed + _GAIN), 0.0)
    lanes = list(dict.fromkeys([command.lane, *([] if stored is None else [stored.lane]), *bound]))
    for lane in lanes:
        for k in range(1 if lane == command.lane else 0, _SPEEDS + 1):
            yield EgoManoeuvre(lane, top * (1 - k / _SPEEDS), braking, 1, 0, braking), Tier.GOVERNED
    if stored is not None:
        yield stored, Tier.GOVERNED
    for lane in lanes:
        for k in range(0, _SPEEDS + 1, 2):
            for n in frames[2:]:
                yield EgoManoeuvre(lane, top * (1 - k / _SPEEDS), braking, n, 0, braking), Tier.GOVERNED
