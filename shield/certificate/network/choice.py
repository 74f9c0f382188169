"""Choice among candidate manoeuvres: the first whose path stays clear of the other vehicles until the ego stands."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.road_networks.simulation.ego_manoeuvres import EgoManoeuvre, EgoOnNetwork, simulate_manoeuvre
from dynamics.state import FloatArray
from shield.certificate.network.clearance import AFTER_REACTION, ASSUMED_KEPT, BRAKING_AT_ONCE, least_separation
from shield.certificate.network.projection import project_path
from shield.certificate.network.tolerances import CLEAR, NEW_PATH_MARGIN
from shield.certificate.network.workspace import CandidateRollout, EgoExtents, NetworkContext, NetworkVehicles

__all__ = ["JudgedCandidate", "choose", "try_candidate", "try_with_braking"]

_OFF, _SAME = 1e3, 1e-6


class JudgedCandidate(NamedTuple):
    """A judged candidate manoeuvre.

    Attributes
    ----------
    manoeuvre : index of the candidate. margin : least separation [m].
    vehicle : vehicle with the least separation; -1 for a standing body, or if there is none.
    clear : number of frames before the first negative separation.
    compliant_margin : least separation from standing bodies and vehicles without a violation [m].
    speed : speed of the ego at the first negative separation, 0 if there is none [m/s].
    """

    manoeuvre: int
    margin: float
    vehicle: int
    clear: int
    compliant_margin: float
    speed: float


@kernel_no_refcount
def _follow(
    alone: EgoOnNetwork, road: NetworkContext, others: NetworkVehicles, row: FloatArray, rollout: CandidateRollout
) -> int:
    """Roll out a candidate, a row of `EgoManoeuvre`, and project its path to the lanes. Return what
    `simulate_manoeuvre` returns."""
    manoeuvre = EgoManoeuvre(int(row[0]), row[1], row[2], int(row[3]), int(row[4]), row[5])
    found = simulate_manoeuvre(
        alone, manoeuvre, road.ways.over, rollout.path, rollout.first, rollout.bound, rollout.own
    )
    project_path(road, road.body, others, rollout.path, abs(found), rollout)
    return found


@kernel_no_refcount
def _weigh(
    road: NetworkContext,
    others: NetworkVehicles,
    found: int,
    trust: int,
    rollout: CandidateRollout,
    bodies: CandidateRollout,
) -> JudgedCandidate:
    """Judge the candidate that `_follow` has rolled out; `found` is what `_follow` returned."""
    count = abs(found)
    rests = found > 0 and abs(rollout.path[count - 1, 3]) < 1e-6
    margin, who, when, compliant_margin = least_separation(others, road, rollout, bodies.boxes, count, rests, trust)
    if found < 0:
        # The path leaves the road, at that speed.
        when = min(when, count - 1)
        return JudgedCandidate(0, -_OFF - rollout.path[when, 3], -1, when, -_OFF, rollout.path[when, 3])
    return JudgedCandidate(0, margin, who, when, compliant_margin, abs(rollout.path[when, 3]) if when < count else 0.0)


@kernel_no_refcount
def _ask(
    road: NetworkContext,
    body: EgoExtents,
    others: NetworkVehicles,
    found: int,
    rollout: CandidateRollout,
    bodies: CandidateRollout,
) -> JudgedCandidate:
    """The same for `BRAKING_AT_ONCE`: vehicles with a distance obligation brake at once, and have to stay behind the
    ego's body."""
    project_path(road, body, others, rollout.path, abs(found), bodies)
    return _weigh(road, others, found, BRAKING_AT_ONCE, rollout, bodies)


@kernel_no_refcount
def try_candidate(
    alone: EgoOnNetwork,
    road: NetworkContext,
    others: NetworkVehicles,
    row: FloatArray,
    lenient: bool,
    rollout: CandidateRollout,
) -> JudgedCandidate:
    """Roll out and judge one candidate, a row of `EgoManoeuvre`; if `lenient`, vehicles with a distance obligation are
    assumed to keep their distance."""
    trust = ASSUMED_KEPT if lenient else AFTER_REACTION
    return _weigh(road, others, _follow(alone, road, others, row, rollout), trust, rollout, rollout)


@kernel_no_refcount
def try_with_braking(
    alone: EgoOnNetwork,
    road: NetworkContext,
    body: EgoExtents,
    others: NetworkVehicles,
    row: FloatArray,
    rollout: CandidateRollout,
    bodies: CandidateRollout,
) -> JudgedCandidate:
    """Roll out and judge one candidate, a row of `EgoManoeuvre`, where vehicles with a distance obligation brake at
    once; see `choose`."""
    return _ask(road, body, others, _follow(alone, road, others, row, rollout), rollout, bodies)


@kernel_inline
def _better(a: JudgedCandidate, b: JudgedCandidate) -> bool:
    """Whether candidate a is preferred to candidate b.

    If either is clear of everything, the larger margin decides. Otherwise, in this order: clear of everything except
    violators, clear for longer, slower at the first negative separation, larger margin.
    """
    if a.margin >= CLEAR or b.margin >= CLEAR:
        return a.margin > b.margin
    if (a.compliant_margin >= CLEAR) != (b.compliant_margin >= CLEAR):
        return a.compliant_margin >= CLEAR
    if a.clear != b.clear:
        return a.clear > b.clear
    if abs(a.speed - b.speed) > _SAME:
        return a.speed < b.speed
    return a.margin > b.margin


@kernel_inline
def _at(found: JudgedCandidate, k: int) -> JudgedCandidate:
    """The same result as candidate k."""
    return JudgedCandidate(k, found.margin, found.vehicle, found.clear, found.compliant_margin, found.speed)


@kernel_no_refcount
def choose(
    alone: EgoOnNetwork,
    road: NetworkContext,
    body: EgoExtents,
    others: NetworkVehicles,
    courses: FloatArray,
    rollout: CandidateRollout,
    bodies: CandidateRollout,
) -> JudgedCandidate:
    """The first candidate whose path stays clear of everything. If there is none, the best by `_better`, where vehicles
    with a distance obligation brake at once and have to stay behind the ego's body.

    Parameters
    ----------
    body : extents of the ego without its buffer. courses : rows of `EgoManoeuvre`, (c, 6).
    rollout : rollout buffer; it is left with the rollout of the chosen candidate, with distance obligations assumed to
        be kept.
    bodies : rollout buffer for the ego without its buffer.
    """
    best, some_obliged = JudgedCandidate(-1, -np.inf, -1, -1, -np.inf, np.inf), others.obliged.any()
    for k in range(courses.shape[0]):
        way = _follow(alone, road, others, courses[k], rollout)
        found = _weigh(road, others, way, AFTER_REACTION, rollout, rollout)
        if found.margin >= NEW_PATH_MARGIN:
            return _at(found, k)
        if best.margin >= NEW_PATH_MARGIN:
            continue
        if some_obliged:
            found = _ask(road, body, others, way, rollout, bodies)
        else:
            found = _weigh(road, others, way, ASSUMED_KEPT, rollout, rollout)
        if _better(found, best):
            best = _at(found, k)
    if best.manoeuvre >= 0:
        try_candidate(alone, road, others, courses[best.manoeuvre], True, rollout)
    return best
