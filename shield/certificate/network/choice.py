"""Choice among candidate manoeuvres: the first whose path stays clear of the other vehicles until the ego stands."""

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
    """A judged candidate manoeuvre.

    Attributes
    ----------
    course : index of the candidate. margin : least separation [m].
    vehicle : vehicle with the least separation; -1 for a standing body, or if there is none.
    clear : number of frames before the first negative separation.
    innocent : least separation from standing bodies and vehicles without a violation [m].
    speed : speed of the ego at the first negative separation, 0 if there is none [m/s].
    """

    course: int
    margin: float
    vehicle: int
    clear: int
    innocent: float
    speed: float


@uncounted
def _follow(alone: Alone, road: Road, others: Others, row: FloatArray, trial: Trial) -> int:
    """Roll out a candidate, a row of `Course`, and project its path to the lanes. Return what `drive` returns."""
    course = Course(int(row[0]), row[1], row[2], int(row[3]), int(row[4]), row[5])
    found = drive(alone, course, road.ways.over, trial.path, trial.first, trial.bound, trial.own)
    survey(road, road.body, others, trial.path, abs(found), trial)
    return found


@uncounted
def _weigh(road: Road, others: Others, found: int, trust: int, trial: Trial, bodies: Trial) -> Choice:
    """Judge the candidate that `_follow` has rolled out; `found` is what `_follow` returned."""
    count = abs(found)
    rests = found > 0 and abs(trial.path[count - 1, 3]) < 1e-6
    margin, who, when, innocent = judge(others, road, trial, bodies.boxes, count, rests, trust)
    if found < 0:
        # The path leaves the road, at that speed.
        when = min(when, count - 1)
        return Choice(0, -_OFF - trial.path[when, 3], -1, when, -_OFF, trial.path[when, 3])
    return Choice(0, margin, who, when, innocent, abs(trial.path[when, 3]) if when < count else 0.0)


@uncounted
def _ask(road: Road, body: Body, others: Others, found: int, trial: Trial, bodies: Trial) -> Choice:
    """The same for `ASKED`: vehicles with a distance obligation brake at once, and have to stay behind the ego's
    body."""
    survey(road, body, others, trial.path, abs(found), bodies)
    return _weigh(road, others, found, ASKED, trial, bodies)


@uncounted
def try_course(alone: Alone, road: Road, others: Others, row: FloatArray, lenient: bool, trial: Trial) -> Choice:
    """Roll out and judge one candidate, a row of `Course`; if `lenient`, vehicles with a distance obligation are
    assumed to keep their distance."""
    trust = BELIEVED if lenient else STRICT
    return _weigh(road, others, _follow(alone, road, others, row, trial), trust, trial, trial)


@uncounted
def ask(alone: Alone, road: Road, body: Body, others: Others, row: FloatArray, trial: Trial, bodies: Trial) -> Choice:
    """Roll out and judge one candidate, a row of `Course`, where vehicles with a distance obligation brake at once; see
    `choose`."""
    return _ask(road, body, others, _follow(alone, road, others, row, trial), trial, bodies)


@inlined
def _better(a: Choice, b: Choice) -> bool:
    """Whether candidate a is preferred to candidate b.

    If either is clear of everything, the larger margin decides. Otherwise, in this order: clear of everything except
    violators, clear for longer, slower at the first negative separation, larger margin.
    """
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
    """The same result as candidate k."""
    return Choice(k, found.margin, found.vehicle, found.clear, found.innocent, found.speed)


@uncounted
def choose(
    alone: Alone, road: Road, body: Body, others: Others, courses: FloatArray, trial: Trial, bodies: Trial
) -> Choice:
    """The first candidate whose path stays clear of everything. If there is none, the best by `_better`, where vehicles
    with a distance obligation brake at once and have to stay behind the ego's body.

    Parameters
    ----------
    body : extents of the ego without its buffer. courses : rows of `Course`, (c, 6).
    trial : rollout buffer; it is left with the rollout of the chosen candidate, with distance obligations assumed to be
        kept.
    bodies : rollout buffer for the ego without its buffer.
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
