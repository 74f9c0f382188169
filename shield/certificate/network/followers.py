"""Vehicles that brake for the ego on a road network: which of them have to, and how near they come by braking.

Followers. A vehicle that approaches from behind in the ego's lane brakes for the ego at
`NetworkFollowerResponse.braking` or harder. It begins `NetworkFollowerResponse.reaction` frames after the ego has
become visible in the lane. Unless `NetworkFollowerResponse.ahead` is set, no vehicle looks beyond the end of its lane:
the follower begins only after it has entered the lane of the ego.

Merging. A vehicle whose lane ends has to move over to the lane beside it, but may first pass the ego: the reachable
interval of the ending lane extends into the lane beside. Such a vehicle has an obligation only where the ego is visible
in the ending lane too.

Notation as in `shield.certificate.network.clearance`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.road_networks.reachable.strips import FRONT, NEAR, SEVERAL, START
from dynamics.state import BoolArray, FloatArray
from shield.certificate.network.lateral_gap import lateral_gap, straight_motion
from shield.certificate.network.projection import FAR_OFF
from shield.certificate.network.tolerances import CLEAR
from shield.certificate.network.workspace import CandidateRollout, NetworkContext, NetworkVehicles

__all__ = ["FollowerBraking", "find_merging", "has_obligation", "is_seen", "separation_behind"]

_FRAME_LIMIT = 100_000
"""Frame limit; a follower that still moves after this many frames is taken as unable to stop."""


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


class FollowerBraking(NamedTuple):
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
def separation_behind(
    others: NetworkVehicles,
    road: NetworkContext,
    rollout: CandidateRollout,
    rears: FloatArray,
    j: int,
    brakes: FollowerBraking,
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
    within, motion = row[NEAR] <= 0, straight_motion(others, road, j)
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
            beside = lateral_gap(road, lane, box, row, motion, rollout.path[m, 3])
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
def is_seen(others: NetworkVehicles, road: NetworkContext, rollout: CandidateRollout, j: int, k: int) -> bool:
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
def has_obligation(
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
        while k <= contact and is_seen(others, road, rollout, before, k):
            k += 1
        k = 0 if k > contact else 1
    else:
        return False
    # The ego's rear is that of its body: its buffer reaches further back by `road.body.along - road.body.length`.
    # The vehicle was behind the ego a frame ago. On a ring, a vehicle ahead of the ego also approaches from behind.
    came = row[FRONT] - row[NEAR] - max(others.rows[i, 3], 0.0) * road.period
    return k == 0 and others.obliged[i, lane] and came + CLEAR <= rollout.rears[lane, 0] < FAR_OFF
