"""Explanation of a refusal on a road network, in the worst case that the assumptions permit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan
from typing import Any

import numpy as np

from dynamics.highway_simulator.layout import HEADING, SPEED, X, Y
from dynamics.road_networks.simulation.ego_manoeuvres import EgoManoeuvre, EgoOnNetwork
from dynamics.road_networks.simulation.frame_kernels import new_work
from shield.certificate.network.choice import JudgedCandidate, choose
from shield.certificate.network.workspace import EgoExtents, NetworkContext, NetworkVehicles, empty_rollout
from shield.decision import Decision, Reason, Tier
from shield.explaining.words import action_name, executed_text, justification_text, nothing_judged
from shield.explaining.worlds import VehicleIdentity, describe, lane_of
from shield.explanation import Explanation, LostGuarantee, number

__all__ = ["NetworkDecisionData", "network_decision_data"]

_OFF = -500.0
"""A margin below this stands for leaving the road [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class NetworkDecisionData:
    """Data of a decision on a road network.

    Attributes
    ----------
    alone, road, body : the ego, its road, and its body without the buffer.
    others, identity : reachable places of the other vehicles, and the simulator's objects.
    tried : the candidates, and the tier of each. lanes : highway-env's name of each other vehicle's lane.
    labels : of the actions.
    size : the ego's length and width [m].
    """

    alone: EgoOnNetwork
    road: NetworkContext
    body: EgoExtents
    others: NetworkVehicles
    identities: Sequence[Any]
    tried: Sequence[tuple[EgoManoeuvre, Tier]]
    lanes: Sequence[tuple[str, str, int]]
    labels: Sequence[str]
    size: tuple[float, float]

    def __reduce__(self) -> Any:
        return type(None), ()

    def explain(self, at: Decision, record: Decision, frame: int) -> Explanation:
        """See `shield.decision.Source`."""
        speed = float(self.alone.worlds.f[0, SPEED, 0])

        def name(action: Any) -> str:
            return action_name(self.labels, action)

        proposal = name(record.proposed)
        if at.reason not in (Reason.UNVERIFIED, Reason.NO_SAFE_PLAN):
            return nothing_judged(at, record, name, speed, proposal, frame)
        found = self._best()
        lost = LostGuarantee.GUARANTEE if at.tier.fallback else LostGuarantee.NOTHING
        tail = executed_text(at, record, name, speed), justification_text(at, lost)
        after, short, cause = found.clear * self.road.period, max(-found.margin, 0.0), None
        if found.margin < _OFF:
            clause, short, why = "road", nan, f"the ego would leave the road after {number(after)} s"
        else:
            clause = "separation"
            lacks = f"the buffer would be short after {number(after)} s, by up to {number(short)} m"
            why = f"a standing body is in the way; {lacks}"
            if found.vehicle >= 0:
                ego = np.array([*self.alone.worlds.f[0, [X, Y, HEADING, SPEED], 0], *self.size])
                identity = VehicleIdentity(self.identities[found.vehicle], lane_of(self.lanes[found.vehicle]))
                cause = describe(ego, self.others.rows[found.vehicle], identity)
                broke = " (it has broken a rule)" if self.others.offends[found.vehicle] else ""
                why = f"{cause.text}{broke} could be in the way; {lacks}"
                if found.margin >= 0:
                    # Candidates that are clear of every vehicle take precedence.
                    why = (
                        "it is clear only if the vehicles behind keep their distance, and another candidate is clear of"
                        f" every vehicle; the nearest is {cause.text}"
                    )
        return Explanation(proposal, at.reason, clause, cause, short, after, why, *tail, at.margin, frame, lost)

    def _best(self) -> JudgedCandidate:
        """The best candidate of the proposal, none of which verifies."""
        wished = [manoeuvre for manoeuvre, tier in self.tried if tier is Tier.PASSED]
        frames, lanes, many = self.others.least.shape[1] - 3, len(self.road.circles), len(self.identities)
        rollout, bodies = empty_rollout(frames, lanes, many), empty_rollout(frames, lanes, 0)
        # The check writes into these two arrays, and the decision still uses its own.
        others = self.others._replace(waits=self.others.waits.copy(), shut=self.others.shut.copy())
        courses = np.array(wished, float)
        found: JudgedCandidate = choose(self.alone, self.road, self.body, others, courses, rollout, bodies)
        return found


def network_decision_data(alone: EgoOnNetwork, **made_from: Any) -> NetworkDecisionData:
    """Data of the present decision, with a copy of the ego's state, which changes later."""
    worlds = alone.worlds._replace(**{name: getattr(alone.worlds, name).copy() for name in alone.worlds._fields})
    return NetworkDecisionData(alone._replace(worlds=worlds, work=new_work(1)), **made_from)
