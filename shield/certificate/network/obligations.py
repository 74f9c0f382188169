"""Right-of-way obligations of other vehicles towards the ego on a road network, from frame to frame: to keep their
distance, and to wait."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dynamics.road_networks.reachable.strips import FRONT, NEAR
from dynamics.state import BoolArray, IntArray
from shield.certificate.network.followers import find_merging
from shield.certificate.network.tolerances import CLEAR
from shield.certificate.network.workspace import CandidateRollout, NetworkContext, NetworkVehicles

__all__ = ["RightOfWayObligations", "find_followers"]


def find_followers(others: NetworkVehicles, rollout: CandidateRollout, road: NetworkContext) -> BoolArray:
    """Whether each vehicle is behind the ego in each lane where the ego is visible, at the start of a path, (m, n).

    A vehicle with a distance obligation may enter the buffer and keeps the obligation, also in the lane that its own
    lane leads to. A vehicle that has yet to move over to a lane is behind there only where it is behind in the ending
    lane too.
    """
    (vehicles, lanes, before), numbers = others.marks.T, others.numbers
    obliged = others.obliged[vehicles, lanes] | ((before >= 0) & others.obliged[vehicles, lanes[before]])
    rear = np.where(obliged, rollout.rears[lanes, 0] - CLEAR, rollout.boxes[lanes, 0, 0])
    there = rollout.seen[lanes, 0] & (numbers[:, FRONT] - numbers[:, NEAR] <= rear)
    out, over = np.zeros(others.obliged.shape, dtype=bool), np.empty(len(lanes), dtype=bool)
    find_merging(others, road, over)
    comes = there & (((numbers[:, NEAR] > 0) & (not road.response.ahead)) | over)
    there &= ~comes
    while there.any():
        out[vehicles[there], lanes[there]] = True
        there = comes & (before >= 0) & out[vehicles, lanes[before]] & ~out[vehicles, lanes]
    return out


@dataclass(slots=True, eq=False)
class RightOfWayObligations:
    """Obligations towards the ego, by vehicle.

    Attributes
    ----------
    distance : lanes in which each vehicle has to keep its distance, because it is behind the ego there.
    waits : lanes before which each vehicle is expected to wait for the ego, and for how many frames it has been.
    """

    distance: dict[Any, set[int]] = field(default_factory=dict)
    waits: dict[Any, dict[int, int]] = field(default_factory=dict)

    def tables(self, identities: list[Any], lanes: int) -> tuple[BoolArray, IntArray]:
        """`NetworkVehicles.obliged` and `NetworkVehicles.gives` of these vehicles, (m, n)."""
        obliged, gives = np.zeros((len(identities), lanes), dtype=bool), np.zeros((len(identities), lanes), np.int64)
        for i, body in enumerate(identities):
            obliged[i, list(self.distance.get(body, ()))] = True
            for lane, since in self.waits.get(body, {}).items():
                gives[i, lane] = since
        return obliged, gives

    def counts_on(self, body: Any, reaction: int) -> bool:
        """Whether a vehicle has been expected to wait for more than `reaction` frames."""
        return max(self.waits.get(body, {}).values(), default=0) > reaction

    def has_distance_obligation(self, body: Any) -> bool:
        """Whether a vehicle has a distance obligation towards the ego."""
        return bool(self.distance.get(body))

    def keep_distance(
        self,
        identities: list[Any],
        others: NetworkVehicles,
        rollout: CandidateRollout,
        road: NetworkContext,
        verified: bool,
    ) -> None:
        """Update the distance obligations, and write them to `NetworkVehicles.obliged`.

        A vehicle keeps its obligation while it is behind the ego in a lane where the ego is visible. If the path of the
        ego is `verified`, every such vehicle gets one. `rollout` begins where the ego is.
        """
        there = find_followers(others, rollout, road)
        if not verified:
            there &= others.obliged
        others.obliged[:] = there
        self.distance = {
            body: set(np.flatnonzero(there[i]).tolist()) for i, body in enumerate(identities) if there[i].any()
        }

    def give_way(
        self,
        identities: list[Any],
        others: NetworkVehicles,
        rollout: CandidateRollout,
        road: NetworkContext,
        verified: bool,
    ) -> None:
        """Update the vehicles that are expected to wait; `NetworkVehicles.waits` refers to the chosen path. If the
        path is not `verified`, no vehicle is added."""
        self.waits = {}
        for j in np.flatnonzero(others.waits & (others.ranks < road.rights[rollout.own[0]])):
            i, lane = others.marks[j, :2]
            since = int(others.gives[i, lane])
            if verified or since > 0:
                self.waits.setdefault(identities[i], {})[int(lane)] = since + 1
