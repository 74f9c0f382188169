"""What the ego may do on a road network: the courses that are tried for a decision, in order."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from dynamics.road_networks.simulation.ego_alone import Course
from shield.decision import Tier

__all__ = ["COMMITTED", "Wish", "courses_of", "frames_of", "gone_on_with", "stopping"]

COMMITTED = 1e3
"""Stands for highway-env's own speed controller, which brakes as hard as it likes [m/s^2]."""
_ON = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0)
"""For how long a course may be kept beyond the coming frame before the ego brakes [s]."""
_SPEEDS = 8
"""Speeds between that of a decision and standing still that are tried in its place."""
_STOP = 5.0
"""Longer than it takes to brake to a standstill [s]."""
_GAIN = 5.0
"""No speed is tried in place of a decision's that is further above the present one [m/s]."""


class Wish(NamedTuple):
    """What a decision asks for: a lane, and a speed [m/s]."""

    lane: int
    speed: float


def frames_of(frequency: float) -> int:
    """How many frames a course takes at most, at so many a second."""
    return math.ceil((max(_ON) + _STOP) * frequency)


def stopping(lane: int, braking: float) -> Course:
    """Braking at once, in a lane."""
    return Course(lane, 0.0, COMMITTED, 0, 0, braking)


def gone_on_with(course: Course, bound: int) -> Course:
    """What is left of a course after a frame, in which the ego has come to be bound for a lane."""
    aside = 0 if course.frames < 1 else course.aside
    return course._replace(lane=bound, frames=max(course.frames - 1, 0), aside=aside)


def courses_of(
    wish: Wish,
    stored: Course | None,
    speed: float,
    bound: Sequence[int],
    several: bool,
    frequency: float,
    braking: float,
) -> Iterator[tuple[Course, Tier]]:
    """What is tried, with the tier that it has where it is clear: first what is wished, then what comes near to it.

    Parameters
    ----------
    stored : what was verified a frame before, if anything. speed : of the ego now [m/s]. bound : the lane that it is
        bound for, and those that it may stay in instead. several : whether the wish is for a road of several lanes, so
        that one can turn aside.
    frequency : frames in a second [Hz]. braking : of the fail-safe [m/s^2].
    """
    frames = [1 + round(seconds * frequency) for seconds in _ON]
    if stored is not None and stored[:3] == (*wish, COMMITTED) and stored.frames >= 1:
        yield stored, Tier.PASSED
    for aside in (0, -1, 1) if several else (0,):
        for n in frames:
            yield Course(wish.lane, wish.speed, COMMITTED, n, aside, braking), Tier.PASSED
    top = max(min(wish.speed, speed + _GAIN), 0.0)
    lanes = list(dict.fromkeys([wish.lane, *([] if stored is None else [stored.lane]), *bound]))
    for lane in lanes:
        for k in range(1 if lane == wish.lane else 0, _SPEEDS + 1):
            yield Course(lane, top * (1 - k / _SPEEDS), braking, 1, 0, braking), Tier.GOVERNED
    if stored is not None:
        yield stored, Tier.GOVERNED
    for lane in lanes:
        for k in range(0, _SPEEDS + 1, 2):
            for n in frames[2:]:
                yield Course(lane, top * (1 - k / _SPEEDS), braking, n, 0, braking), Tier.GOVERNED
