"""Collision mitigation: where no candidate keeps the buffer, keep the ego's body clear."""

from __future__ import annotations

import numpy as np

from dynamics.road_networks.simulation.ego_manoeuvres import EgoOnNetwork
from dynamics.state import FloatArray
from shield.certificate.network.choice import JudgedCandidate, choose, try_candidate
from shield.certificate.network.manoeuvres import COMMITTED
from shield.certificate.network.tolerances import CLEAR
from shield.certificate.network.workspace import CandidateRollout, NetworkContext, NetworkVehicles

__all__ = ["mitigate", "without_buffer"]

_SPEED, _GENTLE = 1, 2
"""Columns of `EgoManoeuvre` rows."""


def without_buffer(road: NetworkContext) -> NetworkContext:
    """The same road for an ego without a buffer."""
    return road._replace(body=road.body._replace(along=road.body.length, across=road.body.width))


def mitigate(
    alone: EgoOnNetwork,
    road: NetworkContext,
    others: NetworkVehicles,
    courses: FloatArray,
    speed: float,
    rollout: CandidateRollout,
    bodies: CandidateRollout,
) -> JudgedCandidate:
    """The candidate that keeps the ego's body clear, or keeps it clear for longest. A candidate faster than now has to
    be better than every slower one.

    Parameters
    ----------
    road : as returned by `without_buffer`. courses : rows of `EgoManoeuvre`, (c, 6). speed : of the ego now [m/s].
    rollout : rollout buffer, left with the rollout of the chosen candidate. bodies : as in `choose`.
    """
    slow = (courses[:, _SPEED] <= speed) & (courses[:, _GENTLE] < COMMITTED)
    slower, faster = np.flatnonzero(slow), np.flatnonzero(~slow)
    least: JudgedCandidate = choose(alone, road, road.body, others, courses[slower], rollout, bodies)
    if least.margin < CLEAR:
        most: JudgedCandidate = choose(alone, road, road.body, others, courses[faster], rollout, bodies)
        # A candidate clear of everything except violators comes before one that is clear for longer.
        longer = most.clear > least.clear and (most.compliant_margin >= CLEAR or least.compliant_margin < CLEAR)
        if most.margin >= CLEAR or longer:
            return most._replace(manoeuvre=int(faster[most.manoeuvre]))
        # The rollout buffer holds the candidate judged last.
        try_candidate(alone, road, others, courses[slower[least.manoeuvre]], True, rollout)
    return least._replace(manoeuvre=int(slower[least.manoeuvre]))
