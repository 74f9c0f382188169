"""Which course the ego takes: the first of several whose path stays clear of everybody until it stands."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.compiled import inlined, uncounted
from dynamics.road_networks.simulation.ego_alone import Alone, Course, drive
from dynamics.state import FloatArray
from shield.certificate.network.clearance import ASKED, BELIEVED, CLEAR, MADE, STRICT, judge
from shield.certificate.network.projection import survey
from shield.certificate.network.workspace import Body, Others, Road, Trial

__all__ = ["Choice", "ask", "choose", "try_course"]

_OFF, _SAME = 1e3, 1e-6


class Choice(NamedTuple):
    """A course that is taken.

    Attributes
    ----------
    course : which of those handed in. margin : least separation [m]. vehicle : from whom, -1 for what stands or nobody.
    clear : frames until it is negative. innocent : least separation from those who have broken no rule [m].
    speed : of the ego then, 0 where it never is [m/s].
    """

    course: int
    margin: float
    vehicle: int
    clear: int
    innocent: float
    speed: float


@uncounted
def _follow(alone: Alone, road: Road, others: Others, row: FloatArray, trial: Trial) -> int:
    """Drive a course, a row of `Course`, and survey its path; what `drive` returns."""
    course = Course(int(row[0]), row[1], row[2], int(row[3]), int(row[4]), row[5])
    found = drive(alone, course, road.ways.over, trial.path, trial.first, trial.bound, trial.own)
    survey(road, road.body, others, trial.path, abs(found), trial)
    return found


@uncounted
def _weigh(road: Road, others: Others, found: int, trust: int, trial: Trial, bodies: Trial) -> Choice:
    """What becomes of the course that `_follow` has driven."""
    count = abs(found)
    rests = found > 0 and abs(trial.path[count - 1, 3]) < 1e-6
    margin, who, when, innocent = judge(others, road, trial, bodies.boxes, count, rests, trust)
    if found < 0:
        # It leaves the road, at that speed.
        when = min(when, count - 1)
        return Choice(0, -_OFF - trial.path[when, 3], -1, when, -_OFF, trial.path[when, 3])
    return Choice(0, margin, who, when, innocent, abs(trial.path[when, 3]) if when < count else 0.0)


@uncounted
def _ask(road: Road, body: Body, others: Others, found: int, trial: Trial, bodies: Trial) -> Choice:
    """The same, where those who owe the ego their distance brake at once: they have to stay behind its body."""
    survey(road, body, others, trial.path, abs(found), bodies)
    return _weigh(road, others, found, ASKED, trial, bodies)


@uncounted
def try_course(alone: Alone, road: Road, others: Others, row: FloatArray, lenient: bool, trial: Trial) -> Choice:
    """What comes of one course, a row of `Course`; `lenient` where those who owe the ego their distance are believed to
    keep it."""
    trust = BELIEVED if lenient else STRICT
    return _weigh(road, others, _follow(alone, road, others, row, trial), trust, trial, trial)


@uncounted
def ask(alone: Alone, road: Road, body: Body, others: Others, row: FloatArray, trial: Trial, bodies: Trial) -> Choice:
    """What comes of one course where those who owe the ego their distance brake at once; see `choose`."""
    return _ask(road, body, others, _follow(alone, road, others, row, trial), trial, bodies)


@inlined
def _better(a: Choice, b: Choice) -> bool:
    """Whether a course is to be preferred to another: one that is clear of all, or else of all who have broken no rule;
    that is clear for longer; that is slower when it is no longer; or has the larger margin. Of two that are clear of
    all the margin decides."""
    if a.margin >= CLEAR or b.margin >= CLEAR:
        return a.margin > b.margin
    if (a.innocent >= CLEAR) != (b.innocent >= CLEAR):
        return a.innocent >= CLEAR
    if a.clear != b.clear:
        return a.clear > b.clear
    if abs(a.speed - b.speed) > _SAME:
        return a.speed < b.speed
    return a.margin > b.margin


@inlined
def _at(found: Choice, k: int) -> Choice:
    return Choice(k, found.margin, found.vehicle, found.clear, found.innocent, found.speed)


@uncounted
def choose(
    alone: Alone, road: Road, body: Body, others: Others, courses: FloatArray, trial: Trial, bodies: Trial
) -> Choice:
    """The first of the courses, rows (c, 6), whose path stays clear of everybody; else the first that does of all but
    those who owe the ego their distance, who stay behind its body there if they brake at once; else the best of them,
    see `_better`.

    Parameters
    ----------
    body : of the ego, without its buffer. bodies : room for where that is.
    trial : what comes of the course that is taken, written; those who owe their distance are believed to keep it.
    """
    best, owed = Choice(-1, -np.inf, -1, -1, -np.inf, np.inf), others.owes.any()
    for k in range(courses.shape[0]):
        way = _follow(alone, road, others, courses[k], trial)
        found = _weigh(road, others, way, STRICT, trial, trial)
        if found.margin >= MADE:
            return _at(found, k)
        if best.margin >= MADE:
            continue
        if owed:
            found = _ask(road, body, others, way, trial, bodies)
        else:
            found = _weigh(road, others, way, BELIEVED, trial, trial)
        if _better(found, best):
            best = _at(found, k)
    if best.course >= 0:
        try_course(alone, road, others, courses[best.course], True, trial)
    return best
