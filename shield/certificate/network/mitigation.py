"""What is left to do where nothing keeps the buffer any more: to save the body."""

from __future__ import annotations

import numpy as np

from dynamics.road_networks.simulation.ego_alone import Alone
from dynamics.state import FloatArray
from shield.certificate.network.choice import Choice, choose, try_course
from shield.certificate.network.clearance import CLEAR
from shield.certificate.network.manoeuvres import COMMITTED
from shield.certificate.network.workspace import Others, Road, Trial

__all__ = ["bare", "save"]

_SPEED, _GENTLE = 1, 2
"""Columns of courses, as `Course` has them."""


def bare(road: Road) -> Road:
    """The same road for an ego without its buffer."""
    return road._replace(body=road.body._replace(along=road.body.length, across=road.body.width))


def save(
    alone: Alone, road: Road, others: Others, courses: FloatArray, speed: float, trial: Trial, bodies: Trial
) -> Choice:
    """What keeps the body clear, or does for longest; nothing faster than now, where that does as long.

    Parameters
    ----------
    road : as of `bare`. courses : rows (c, 6) of `Course`. speed : of the ego now [m/s].
    trial : what comes of the course that is taken, written. bodies : as in `choose`.
    """
    slow = (courses[:, _SPEED] <= speed) & (courses[:, _GENTLE] < COMMITTED)
    slower, faster = np.flatnonzero(slow), np.flatnonzero(~slow)
    least: Choice = choose(alone, road, road.body, others, courses[slower], trial, bodies)
    if least.margin < CLEAR:
        most: Choice = choose(alone, road, road.body, others, courses[faster], trial, bodies)
        # What is clear of all who have broken no rule comes before what is clear for longer.
        longer = most.clear > least.clear and (most.innocent >= CLEAR or least.innocent < CLEAR)
        if most.margin >= CLEAR or longer:
            return most._replace(course=int(faster[most.course]))
        # The trial holds what comes of what was judged last.
        try_course(alone, road, others, courses[slower[least.course]], True, trial)
    return least._replace(course=int(slower[least.course]))
