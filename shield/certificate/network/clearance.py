"""Least separation of a path of the ego from every place that the other vehicles can reach, on a road network.

Notation
--------
As in `dynamics.road_networks.reachable.strips`: a *reachable interval* is a strip, a row of `NetworkVehicles.marks` and
`NetworkVehicles.numbers`. The ego's footprint with its buffer covers s from `box[0]` to `box[1]` of a lane, and r from
`box[2]` to `box[3]`. A vehicle that has driven x towards that lane is within its band, at s between x - FAR - BODY_HALF
and x - NEAR + BODY_HALF. The *separation* is the greater of the gaps along and across the lane. It is negative where
the footprints overlap in both.

Followers, and vehicles that merge, brake for the ego as in `shield.certificate.network.followers`.

Right of way. With `NetworkFollowerResponse.gives_way`, a vehicle with less right of way than the ego brakes in the
same way before any lane. It does so from when the ego has the right of way. It counts as waiting if it can stay behind
the ego's body by braking so.

No other vehicle yields: crossing, merging and oncoming vehicles may be anywhere in their reachable intervals.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.compiled import kernel_no_refcount
from dynamics.highway_simulator.layout import LANE_LENGTH
from dynamics.road_networks.reachable.strips import ALWAYS, BODY_HALF, FAR, FRONT, NEAR, SEVERAL, START, end_of_lane
from dynamics.state import FloatArray
from dynamics.traffic.rules_of_the_road import EgoFootprint, gap_between
from shield.certificate.network.followers import FollowerBraking, has_obligation, is_seen, separation_behind
from shield.certificate.network.lateral_gap import lateral_gap, straight_motion
from shield.certificate.network.projection import FAR_OFF
from shield.certificate.network.tolerances import CLEAR
from shield.certificate.network.workspace import CandidateRollout, NetworkContext, NetworkVehicles

__all__ = ["AFTER_REACTION", "ASSUMED_KEPT", "BRAKING_AT_ONCE", "least_separation"]

AFTER_REACTION, ASSUMED_KEPT, BRAKING_AT_ONCE = 0, 1, 2
"""What is assumed of vehicles with a distance obligation:

- `AFTER_REACTION`: as any follower, they react after the reaction time and have to stay behind the buffer.
- `ASSUMED_KEPT`: they keep their distance.
- `BRAKING_AT_ONCE`: they brake at once, and have to stay behind the ego's body by braking so.
"""

_NEARLY = 1e-3
"""Distances to one lane that differ by less count as equal [m]."""
_DOES_NOT_YIELD = -1.0
"""Stands for the separation from a vehicle that does not brake for the ego [m]; any value below `CLEAR` would do."""


class _Conflict(NamedTuple):
    """Separation from a vehicle in a reachable interval, if it does not yield.

    Attributes
    ----------
    j : row of the reachable interval. least : least separation [m], inf if they never come near.
    first, last : first and last frame with a negative separation; the number of places, and -1, if there is none.
    there : whether the ego stays in the lane for good.
    """

    j: int
    least: float
    first: int
    last: int
    there: bool


@kernel_no_refcount
def _separation_from_standing(
    others: NetworkVehicles, road: NetworkContext, path: FloatArray, count: int
) -> tuple[float, int]:
    """Least separation of the first `count` places of a path from the standing bodies [m], and the first frame in which
    one is negative, `count` if there is none."""
    body, worst, when = road.body, np.inf, count
    for j in range(others.things.shape[0]):
        for k in range(count):
            ego = EgoFootprint(
                path[k, 0], path[k, 1], path[k, 2], path[k, 3], body.along, body.across, 0.0, 0.0, False, False
            )
            gap = gap_between(ego, body.along, body.across, others.things, j, 0.0)
            gap = min(gap, gap_between(ego, body.length, body.width, others.things, j, road.period))
            if gap < 0:
                when = min(when, k)
            if gap < worst:
                worst = gap
    return worst, when


@kernel_no_refcount
def _is_blocked(others: NetworkVehicles, road: NetworkContext, j: int) -> bool:
    """Whether the ego blocks every way that leads to reachable interval j. If several lead there, each has to be
    blocked, and to have been judged before j."""
    marks, numbers, ways, before = others.marks, others.numbers, road.ways, others.marks[j, 2]
    if before >= 0:
        return others.shut[before]
    if before != SEVERAL:
        return False
    some, lane = False, marks[j, 1]
    for k in range(others.found[0]):
        if marks[k, 0] != marks[j, 0]:
            continue
        leads = ways.over[marks[k, 1]] == lane
        for c in range(ways.after.shape[1]):
            if ways.after[marks[k, 1], c] == lane:
                ends = ways.ends[marks[k, 1], c]
                near = numbers[k, NEAR] + road.lanes.rows[marks[k, 1], LANE_LENGTH] - ends[0] - ends[2]
                leads = leads or abs(near - numbers[j, NEAR]) < _NEARLY
        if leads:
            if k >= j or not others.shut[k]:
                return False
            some = True
    return some


@kernel_no_refcount
def _conflict(
    others: NetworkVehicles, road: NetworkContext, rollout: CandidateRollout, j: int, count: int, rests: bool
) -> _Conflict:
    """Separation of the first `count` places of a path from the vehicle of reachable interval j, wherever it is in
    it; `rests` as in `least_separation`."""
    i, lane, row = others.marks[j, 0], others.marks[j, 1], others.numbers[j]
    first, last = rollout.met[lane, 0], rollout.met[lane, 1]
    end = end_of_lane(road.lanes.rows, road.ways.after, lane) + road.ways.overruns[lane]
    least, bad, contact, motion = np.inf, count, -1, straight_motion(others, road, j)
    if road.ways.leads_off[lane]:
        end += motion.way
    for k in range(first, last + 1):
        box = rollout.boxes[lane, k]
        if not box[0] < FAR_OFF:
            continue
        beside = lateral_gap(road, lane, box, row, motion, rollout.path[k, 3])
        # Both vehicles move between two frames: of one that rolls back the later frame counts.
        back = min(others.least[i, max(k - 1, 0)], others.least[i, k + 1]) - row[FAR]
        ahead = others.most[i, k + 1] - row[NEAR]
        if rests and k == count - 1:
            ahead = ALWAYS
            # A vehicle that rolls back does so until it stands.
            back = min(back, others.least[i, others.least.shape[1] - 1] - row[FAR])
        back, ahead = max(back, row[START]), min(ahead, max(end, -row[NEAR]))
        if back > ahead:
            continue
        along = max(box[0] - row[BODY_HALF] - ahead, back - row[BODY_HALF] - box[1])
        gap = max(along, beside)
        least = min(least, gap)
        if gap < 0:
            contact, bad = k, min(bad, k)
    return _Conflict(j, least, bad, contact, rests and last == count - 1)


@kernel_no_refcount
def _separation_if_it_follows(
    others: NetworkVehicles,
    road: NetworkContext,
    rollout: CandidateRollout,
    bodies: FloatArray,
    conflict: _Conflict,
    trust: int,
) -> float:
    """Least separation from a vehicle that brakes for the ego as a follower [m]; inf if it is assumed to keep its
    distance, and negative if it need not or cannot stay behind. `bodies` and `trust` as in `least_separation`."""
    j, contact = conflict.j, conflict.last
    row, box = others.numbers[j], rollout.boxes[others.marks[j, 1], conflict.first]
    since = contact + 1
    while since > 0 and is_seen(others, road, rollout, j, since - 1):
        since -= 1
    # Followers see the ego from frame `since` on.
    if since > contact:
        return _DOES_NOT_YIELD
    obliged = trust != AFTER_REACTION and has_obligation(others, road, rollout, j, since, contact)
    if obliged and trust == ASSUMED_KEPT:
        return np.inf
    if obliged and trust == BRAKING_AT_ONCE:
        return separation_behind(
            others, road, rollout, bodies, j, FollowerBraking(0, 0, True, row[FRONT]), conflict.there
        )
    if not -row[NEAR] + row[BODY_HALF] <= box[0]:
        return _DOES_NOT_YIELD
    brakes = FollowerBraking(since, road.response.reaction, road.response.ahead, row[BODY_HALF])
    return separation_behind(others, road, rollout, rollout.boxes, j, brakes, conflict.there)


@kernel_no_refcount
def _separation_if_it_waits(
    others: NetworkVehicles, road: NetworkContext, rollout: CandidateRollout, conflict: _Conflict, lenient: bool
) -> float:
    """Least separation from a vehicle with less right of way that waits before its reachable interval [m]; negative
    where it need not or cannot wait.

    Parameters
    ----------
    lenient : whether the frames for which the vehicle has already been expected to wait count towards its reaction
        time.
    """
    j, bad = conflict.j, conflict.first
    i, row, lane = others.marks[j, 0], others.numbers[j], others.marks[j, 1]
    since = conflict.last + 1
    while since > 0 and road.rights[rollout.own[since - 1]] > others.ranks[j]:
        since -= 1
    if since > bad or row[BODY_HALF] - row[NEAR] > rollout.boxes[lane, bad, 0]:
        return _DOES_NOT_YIELD
    delay, given = road.response.reaction, others.gives[i, lane]
    if lenient and given > 0 and since == 0:
        delay = max(delay - given, 0)
    brakes = FollowerBraking(since, delay, True, row[BODY_HALF])
    return separation_behind(others, road, rollout, rollout.boxes, j, brakes, conflict.there)


@kernel_no_refcount
def _shuts(road: NetworkContext, rollout: CandidateRollout, lane: int, there: bool) -> bool:
    """Whether the ego at rest blocks the way out of a lane; `there` is whether it stays in the lane for good.

    A follower that has to stay behind the ego's body does not reach the next lane while the ego's rear is within this
    one. This has to hold for any size, with the buffer and without it: a frame later the obligation may refer to the
    body alone. The ego also has to cover the centre of the lane, which lies in every band: a frame later the band may
    be narrower.
    """
    boxes, last, end = rollout.boxes, rollout.met[lane, 1], end_of_lane(road.lanes.rows, road.ways.after, lane)
    return there and rollout.rears[lane, 1] <= end and boxes[lane, last, 2] < 0.0 < boxes[lane, last, 3]


@kernel_no_refcount
def least_separation(
    others: NetworkVehicles,
    road: NetworkContext,
    rollout: CandidateRollout,
    bodies: FloatArray,
    count: int,
    rests: bool,
    trust: int,
) -> tuple[float, int, int, float]:
    """Least separation from the other vehicles along the first `count` places of a path that has been projected to the
    lanes (`shield.certificate.network.projection.project_path`).

    Parameters
    ----------
    rollout : path and its boxes on the lanes. Its `margins`, one a vehicle, are written (m,) [m].
    bodies : boxes of the ego's body without its buffer, (n, K, 4) [m]; read only with trust `BRAKING_AT_ONCE`.
    count : places of the path to judge. rests : whether the ego stays at the last of them for good.
    trust : `AFTER_REACTION`, `ASSUMED_KEPT` or `BRAKING_AT_ONCE`.

    Returns
    -------
    The least separation [m]; its vehicle, -1 for a standing body; the first frame with a negative separation, `count`
    if there is none; and the least separation from standing bodies and vehicles without a violation [m].
    """
    margins, met = rollout.margins, rollout.met
    margins[:] = np.inf
    worst, when = _separation_from_standing(others, road, rollout.path, count)
    who, compliant_margin = -1, worst
    for j in range(others.found[0]):
        i, lane = others.marks[j, 0], others.marks[j, 1]
        others.shut[j], others.waits[j] = _is_blocked(others, road, j), False
        if others.shut[j] or met[lane, 1] < met[lane, 0]:
            continue
        conflict = _conflict(others, road, rollout, j, count, rests)
        least, bad, yields = conflict.least, conflict.first, False
        if least < 0:
            stays = _separation_if_it_follows(others, road, rollout, bodies, conflict, trust)
            if stays >= CLEAR:
                least, bad, yields = stays, count, True
            if least < 0 and road.response.gives_way:
                stays = _separation_if_it_waits(others, road, rollout, conflict, trust != AFTER_REACTION)
                if stays >= CLEAR:
                    least, bad, yields, others.waits[j] = stays, count, True, True
        if yields:
            others.shut[j] = conflict.last == count - 1 and _shuts(road, rollout, lane, conflict.there)
        margins[i] = min(margins[i], least)
        when = min(when, bad)
        if not others.offends[i]:
            compliant_margin = min(compliant_margin, least)
        if least < worst:
            worst, who = least, i
    return worst, who, when, compliant_margin
