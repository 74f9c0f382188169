"""Least separation of a path of the ego from every place that the other vehicles can reach, on a road network.

Notation
--------
As in `dynamics.road_networks.reachable.strips`: a *reachable interval* is a strip, a row of `NetworkVehicles.marks` and
`NetworkVehicles.numbers`. The ego's footprint with its buffer covers s from `box[0]` to `box[1]` of a lane, and r from
`box[2]` to `box[3]`. A vehicle that has driven x towards that lane is within its band, at s between x - FAR - BODY_HALF
and x - NEAR + BODY_HALF. The *separation* is the greater of the gaps along and across the lane. It is negative where
the footprints overlap in both.

Followers. A vehicle that approaches from behind in the ego's lane brakes for the ego at
`NetworkFollowerResponse.braking` or harder. It begins `NetworkFollowerResponse.reaction` frames after the ego has
become visible in the lane. Unless `NetworkFollowerResponse.ahead` is set, no vehicle looks beyond the end of its lane:
the follower begins only after it has entered the lane of the ego.

Merging. A vehicle whose lane ends has to move over to the lane beside it, but may first pass the ego: the reachable
interval of the ending lane extends into the lane beside. Such a vehicle has an obligation only where the ego is visible
in the ending lane too.

Right of way. With `NetworkFollowerResponse.gives_way`, a vehicle with less right of way than the ego brakes in the
same way before any lane. It does so from when the ego has the right of way. It counts as waiting if it can stay behind
the ego's body by braking so.

No other vehicle yields: crossing, merging and oncoming vehicles may be anywhere in their reachable intervals.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.layout import LANE_LENGTH
from dynamics.road_networks.geometry.lanes import NetworkLanes
from dynamics.road_networks.geometry.layout import AMPLITUDE, PULSATION, SHAPE, SINE
from dynamics.road_networks.reachable.strips import (
    ALWAYS,
    BODY_HALF,
    CENTRED_FROM,
    CENTRED_HALF,
    FAR,
    FRONT,
    HIGH,
    LOW,
    NEAR,
    SEVERAL,
    START,
    curvature,
    is_dead_end,
)
from dynamics.state import BoolArray, FloatArray, Vehicle
from dynamics.traffic.rules_of_the_road import EgoFootprint, gap_between
from shield.certificate.network.projection import FAR_OFF
from shield.certificate.network.workspace import CandidateRollout, NetworkContext, NetworkVehicles

__all__ = [
    "AFTER_REACTION",
    "ASSUMED_KEPT",
    "BRAKING_AT_ONCE",
    "CLEAR",
    "NEW_PATH_MARGIN",
    "find_merging",
    "least_separation",
]

_LENGTH, _SPEED = int(Vehicle.LENGTH), int(Vehicle.SPEED)
AFTER_REACTION, ASSUMED_KEPT, BRAKING_AT_ONCE = 0, 1, 2
"""What is assumed of vehicles with a distance obligation:

- `AFTER_REACTION`: as any follower, they react after the reaction time and have to stay behind the buffer.
- `ASSUMED_KEPT`: they keep their distance.
- `BRAKING_AT_ONCE`: they brake at once, and have to stay behind the ego's body by braking so.
"""

CLEAR = -1e-6
"""Least margin of a path that counts as clear [m]; a smaller one is more than a rounding error."""
NEW_PATH_MARGIN = -1e-9
"""Least margin of a newly chosen path [m]. The difference to `CLEAR` is a budget for rounding and for the tolerances of
`shield.certificate.network.monitor`. They reduce the margin of a path frame by frame, and add up."""
_NEARLY = 1e-3
"""Distances to one lane that differ by less count as equal [m]."""
_FRAME_LIMIT = 100_000
"""Frame limit; a follower that still moves after this many frames is taken as unable to stop."""


@kernel_no_refcount
def _tangent_displacement(lanes: NetworkLanes, lane: int, length: float, way: float) -> float:
    """Displacement of the front of a body across the lane [m], if the body points along the lane and moves straight on
    for `way` [m]; `length` is that of the body [m]."""
    bend = curvature(lanes, lane)
    if lanes.ids[lane, SHAPE] == SINE:
        bend = abs(lanes.rows[lane, AMPLITUDE]) * lanes.rows[lane, PULSATION] * lanes.rows[lane, PULSATION]
    return 0.5 * bend * (length * way + way * way)


@kernel_no_refcount
def _sag_of(others: NetworkVehicles, road: NetworkContext, j: int) -> float:
    """Upper bound on `_tangent_displacement` [m] within one frame, for the vehicle of reachable interval j."""
    i = others.marks[j, 0]
    row = others.rows[i]
    way = max(others.drive[i, 0], row[_SPEED], 0.0) * road.period
    return _tangent_displacement(road.lanes, others.marks[j, 1], row[_LENGTH], way)


@kernel_no_refcount
def _extra_lateral_gap(road: NetworkContext, lane: int, its: float, speed: float) -> float:
    """Lateral separation [m] that the ego's body and another body need beyond the ego's buffer.

    highway-env moves both bodies straight on for the coming frame and counts a collision if they meet. On a curved lane
    this brings the inner one of the two bodies nearer, and not the outer one. `its` is the other's `_sag_of` [m],
    `speed` the ego's [m/s].
    """
    body = road.body
    own = _tangent_displacement(road.lanes, lane, 2 * body.length, max(speed, 0.0) * road.period)
    return max(max(its, own) - (body.across - body.width), 0.0)


@kernel_inline
def _lateral_gap(box: FloatArray, row: FloatArray, aside: float) -> float:
    """Gap across the lane between the ego's box and a reachable interval, less `aside` [m]. Beyond `CENTRED_FROM`, a
    vehicle that came from beside the centre is back within `CENTRED_HALF` of it."""
    if box[0] - row[BODY_HALF] + row[NEAR] >= row[CENTRED_FROM]:
        return max(box[2] - row[CENTRED_HALF], -row[CENTRED_HALF] - box[3]) - aside
    return max(box[2] - row[HIGH], row[LOW] - box[3]) - aside


@kernel_inline
def _arrival(v: float, way: float, drive: FloatArray, acceleration: float, dt: float) -> float:
    """Upper bound on the speed [m/s] of a vehicle in its first frame beyond a distance `way` [m], wherever between two
    frames it gets there.

    Let share be the least share of the distance that the vehicle gains along its lanes. Then v (v - a dt) + 2 a way /
    share increases in no frame, however the vehicle drives. So this bound does not increase either. A vehicle that
    creeps and steers hard may gain less of the distance. It is taken to have the greatest speed that it can have when
    it stops creeping.

    Parameters
    ----------
    v : speed now [m/s]. way : distance along the lanes [m]. drive : row of `NetworkVehicles.drive`, (5,).
    acceleration : greatest acceleration [m/s^2]. dt : frame [s].
    """
    step, most = acceleration * dt, drive[2] / drive[1]
    v = max(v, drive[3] + step)
    reserve = max(v * (v - step), 0.0) + 2 * acceleration * max(way, 0.0) / drive[1]
    half = 0.5 + most
    return half * step + math.sqrt(reserve + (half * half - 2 * most) * step * step)


class _Brakes(NamedTuple):
    """How a vehicle brakes for the ego.

    Attributes
    ----------
    since : frame from which it sees the ego. delay : frames from then until it brakes.
    anywhere : whether it brakes in any lane, or only where `NetworkFollowerResponse.ahead` permits.
    front : distance from its centre to its front [m]. That is `FRONT`, with the present pose, for a vehicle with a
        distance obligation, which may not move its front further ahead. For others it is `BODY_HALF`: on an arc the
        front moves ahead when the body drifts towards the centre of the arc, which is permitted.
    """

    since: int
    delay: int
    anywhere: bool
    front: float


@kernel_no_refcount
def _followed(
    others: NetworkVehicles,
    road: NetworkContext,
    rollout: CandidateRollout,
    rears: FloatArray,
    j: int,
    brakes: _Brakes,
    rests: bool,
) -> float:
    """Least separation of the ego from a follower in reachable interval j that brakes for it [m]; a negative value
    where the follower cannot stay behind.

    Parameters
    ----------
    rollout : rollout of the ego. j : row of the reachable interval. brakes : how the follower brakes.
    rears : boxes like those of `rollout`, (n, K, 4) [m]. Where the follower is not beside the boxes of `rollout`, it
        has to stay behind the rear of these.
    rests : whether the ego stays at its last place for good.
    """
    bounds, response, dt = road.bounds, road.response, road.period
    i, row, lane = others.marks[j, 0], others.numbers[j], others.marks[j, 1]
    boxes, first, last = rollout.boxes, rollout.met[lane, 0], rollout.met[lane, 1]
    top, most = max(others.drive[i, 0], others.rows[i, 3]), others.drive[i, 2]
    v0 = max(others.rows[i, 3], 0.0)
    v, x, waited, least, k = v0, 0.0, 0, np.inf, 0
    within, sag = row[NEAR] <= 0, _sag_of(others, road, j)
    while k <= last or (rests and v > 0.0):
        if k > _FRAME_LIMIT:
            return -1.0
        m = min(k, last)
        box, rear = boxes[lane, m], rears[lane, m, 0]
        # Both vehicles move between two frames.
        ahead = x + v * most * dt - row[NEAR]
        if k >= first and box[0] < FAR_OFF and ahead >= row[START]:
            if not rear < FAR_OFF:
                rear = box[0]
            beside = _lateral_gap(box, row, _extra_lateral_gap(road, lane, sag, rollout.path[m, 3]))
            least = min(least, max(rear - brakes.front - ahead, beside))
            if least < CLEAR:
                return least
        there = brakes.anywhere or x >= row[NEAR]
        if there and not brakes.anywhere and not within:
            # A slower vehicle may be further into the lane in its first frame there, and faster.
            v = max(v, min(_arrival(v0, row[NEAR], others.drive[i], bounds.acceleration, dt), top))
            x = row[NEAR] + v * most * dt
            within = True
        waited = waited + 1 if k >= brakes.since and there else 0
        x += v * most * dt
        v = max(v - response.braking * dt, 0.0) if waited > brakes.delay else min(v + bounds.acceleration * dt, top)
        k += 1
    return least


@kernel_no_refcount
def _has_to_merge(others: NetworkVehicles, road: NetworkContext, j: int) -> bool:
    """Whether the vehicle of reachable interval j has to move over to the lane of j, from a lane beside it that
    ends."""
    marks, over = others.marks, road.ways.over
    if marks[j, 2] != SEVERAL:
        return marks[j, 2] >= 0 and over[marks[marks[j, 2], 1]] == marks[j, 1]
    comes = False
    for k in range(others.found[0]):
        comes = comes or (marks[k, 0] == marks[j, 0] and over[marks[k, 1]] == marks[j, 1])
    return comes


@kernel_no_refcount
def find_merging(others: NetworkVehicles, road: NetworkContext, found: BoolArray) -> None:
    """For each reachable interval, whether its vehicle has to move over to the lane from one beside it that ends;
    written to `found`, (k,)."""
    for j in range(len(found)):
        found[j] = _has_to_merge(others, road, j)


@kernel_no_refcount
def _is_seen(others: NetworkVehicles, road: NetworkContext, rollout: CandidateRollout, j: int, k: int) -> bool:
    """Whether the vehicle of reachable interval j sees the ego in its lane in frame k. If it has yet to move over from
    an ending lane, the ego has to be visible in the ending lane as well."""
    while rollout.seen[others.marks[j, 1], k]:
        if not _has_to_merge(others, road, j):
            return True
        j = others.marks[j, 2]
        if j == SEVERAL:
            return False
    return False


@kernel_no_refcount
def _has_obligation(
    others: NetworkVehicles, road: NetworkContext, rollout: CandidateRollout, j: int, since: int, contact: int
) -> bool:
    """Whether the vehicle of reachable interval j has a distance obligation in that lane up to frame `contact`. The ego
    is visible in the lane from frame `since` on.

    Before the vehicle has entered that lane, it needs an obligation in the lane before, and the ego has to stay visible
    there.
    """
    i, row, before = others.marks[j, 0], others.numbers[j], others.marks[j, 2]
    if row[NEAR] <= 0 or road.response.ahead:
        lane, k = others.marks[j, 1], since
    elif before >= 0 and others.numbers[before, NEAR] <= 0:
        row, lane, k = others.numbers[before], others.marks[before, 1], 0
        while k <= contact and _is_seen(others, road, rollout, before, k):
            k += 1
        k = 0 if k > contact else 1
    else:
        return False
    # It was behind the ego a frame ago. On a ring, a vehicle ahead of the ego also approaches from behind.
    came = row[FRONT] - row[NEAR] - max(others.rows[i, 3], 0.0) * road.period
    return k == 0 and others.obliged[i, lane] and came + CLEAR <= rollout.rears[lane, 0] < FAR_OFF


@kernel_no_refcount
def _waits(
    others: NetworkVehicles,
    road: NetworkContext,
    rollout: CandidateRollout,
    j: int,
    contact: int,
    bad: int,
    there: bool,
    lenient: bool,
) -> float:
    """Least separation from a vehicle with less right of way that waits before reachable interval j [m]; negative where
    it need not or cannot wait.

    Parameters
    ----------
    contact, bad : last and first frame with a negative separation if it does not wait.
    there : whether the ego stays in the lane for good.
    lenient : whether the frames for which the vehicle has already been expected to wait count towards its reaction
        time.
    """
    i, row, lane = others.marks[j, 0], others.numbers[j], others.marks[j, 1]
    since = contact + 1
    while since > 0 and road.rights[rollout.own[since - 1]] > others.ranks[j]:
        since -= 1
    if since > bad or row[BODY_HALF] - row[NEAR] > rollout.boxes[lane, bad, 0]:
        return -1.0
    delay, given = road.response.reaction, others.gives[i, lane]
    if lenient and given > 0 and since == 0:
        delay = max(delay - given, 0)
    return _followed(others, road, rollout, rollout.boxes, j, _Brakes(since, delay, True, row[BODY_HALF]), there)


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
    path, boxes, met, margins = rollout.path, rollout.boxes, rollout.met, rollout.margins
    rows, body, dt = road.lanes.rows, road.body, road.period
    worst, who, when, compliant_margin = np.inf, -1, count, np.inf
    margins[:] = np.inf
    for j in range(others.things.shape[0]):
        for k in range(count):
            ego = EgoFootprint(
                path[k, 0], path[k, 1], path[k, 2], path[k, 3], body.along, body.across, 0.0, 0.0, False, False
            )
            gap = gap_between(ego, body.along, body.across, others.things, j, 0.0)
            gap = min(gap, gap_between(ego, body.length, body.width, others.things, j, dt))
            if gap < 0:
                when = min(when, k)
            if gap < worst:
                worst, who = gap, -1
            compliant_margin = min(compliant_margin, gap)
    for j in range(others.found[0]):
        i, lane, row = others.marks[j, 0], others.marks[j, 1], others.numbers[j]
        first, last = met[lane, 0], met[lane, 1]
        others.shut[j], others.waits[j] = _is_blocked(others, road, j), False
        if others.shut[j] or last < first:
            continue
        joint = ALWAYS if is_dead_end(road.ways, lane) else rows[lane, LANE_LENGTH]
        end = joint + road.ways.overruns[lane]
        least, bad, contact, sag = np.inf, count, -1, _sag_of(others, road, j)
        there = rests and last == count - 1
        # A follower that has to stay behind the ego's body does not reach the next lane while the ego's rear is within
        # this one. This has to hold for any size, with the buffer and without it: a frame later the obligation may
        # refer to the body alone. The ego also has to cover the centre of the lane, which lies in every band: a frame
        # later the band may be narrower.
        closes = there and rollout.rears[lane, 1] <= joint and boxes[lane, last, 2] < 0.0 < boxes[lane, last, 3]
        for k in range(first, last + 1):
            box = boxes[lane, k]
            if not box[0] < FAR_OFF:
                continue
            beside = _lateral_gap(box, row, _extra_lateral_gap(road, lane, sag, path[k, 3]))
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
        if least < 0:
            since = contact + 1
            while since > 0 and _is_seen(others, road, rollout, j, since - 1):
                since -= 1
            # Followers that see the ego from frame `since` on.
            box = boxes[lane, bad]
            if since <= contact:
                start = -row[NEAR] + row[BODY_HALF] <= box[0]
                obliged = trust != AFTER_REACTION and _has_obligation(others, road, rollout, j, since, contact)
                at_once = obliged and trust == BRAKING_AT_ONCE
                if obliged and trust == ASSUMED_KEPT:
                    others.shut[j] = closes and contact == count - 1
                    least, bad = np.inf, count
                elif start or at_once:
                    brakes = _Brakes(since, road.response.reaction, road.response.ahead, row[BODY_HALF])
                    if at_once:
                        brakes = _Brakes(0, 0, True, row[FRONT])
                    stays = _followed(others, road, rollout, bodies if at_once else boxes, j, brakes, there)
                    if stays >= CLEAR:
                        others.shut[j] = closes and contact == count - 1
                        least, bad = stays, count
            if least < 0 and road.response.gives_way:
                stays = _waits(others, road, rollout, j, contact, bad, there, trust != AFTER_REACTION)
                if stays >= CLEAR:
                    others.shut[j], others.waits[j] = closes and contact == count - 1, True
                    least, bad = stays, count
        margins[i] = min(margins[i], least)
        when = min(when, bad)
        if not others.offends[i]:
            compliant_margin = min(compliant_margin, least)
        if least < worst:
            worst, who = least, i
    return worst, who, when, compliant_margin
