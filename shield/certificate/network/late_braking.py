"""Late braking: vehicles with a distance obligation that could have kept their distance by braking, and no longer
can."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.road_networks.simulation.ego_manoeuvres import EgoManoeuvre, EgoOnNetwork
from dynamics.state import FloatArray
from shield.certificate.network.choice import try_candidate, try_with_braking
from shield.certificate.network.mitigation import without_buffer
from shield.certificate.network.monitor import NetworkObservation
from shield.certificate.network.tolerances import CLEAR, NEW_PATH_MARGIN
from shield.certificate.network.workspace import (
    CandidateRollout,
    EgoExtents,
    NetworkContext,
    NetworkVehicles,
    empty_rollout,
)

__all__ = ["LateBraking"]


@dataclass(slots=True, eq=False)
class LateBraking:
    """Separation of the vehicles with a distance obligation from the ego's body, if they brake at once.

    Attributes
    ----------
    alone, road : of the ego. body : extents of the ego without its buffer.
    rollout, bodies : rollout buffers, see `choose`.
    stays : separation of each vehicle that had an obligation when `remember` was called [m].
    """

    alone: EgoOnNetwork
    road: NetworkContext
    body: EgoExtents
    rollout: CandidateRollout
    bodies: CandidateRollout
    stays: dict[Any, float]

    @classmethod
    def on(cls, alone: EgoOnNetwork, road: NetworkContext, frames: int, stays: dict[Any, float]) -> LateBraking:
        """Braking on a road, with rollout buffers for paths of at most `frames` frames; `stays` comes from the road
        before."""
        lanes = len(road.ways.over)
        return cls(
            alone,
            road,
            without_buffer(road).body,
            empty_rollout(frames, lanes, 0),
            empty_rollout(frames, lanes, 0),
            stays,
        )

    def remember(self, manoeuvre: EgoManoeuvre, identities: list[Any], others: NetworkVehicles) -> None:
        """Store the separation of each vehicle in `who` with a distance obligation, if the ego continues with
        `manoeuvre`."""
        margins = self._margins(manoeuvre, others)
        self.stays = {identities[i]: float(margins[i]) for i in np.flatnonzero(others.obliged.any(axis=1))}

    def now(self, manoeuvre: EgoManoeuvre, seen: NetworkObservation) -> tuple[FloatArray, set[Any]]:
        """Judge that candidate a frame later.

        Returns
        -------
        The separation of its path from each vehicle, (m,) [m]; and the vehicles that could keep their distance by
        braking when `remember` was called, and no longer can. No vehicle is assumed to keep a distance that it cannot
        keep.
        """
        at_once = self._margins(manoeuvre, seen.others)
        self._fit(seen.others)
        try_candidate(self.alone, self.road, seen.others, np.array(manoeuvre, float), True, self.rollout)
        believed = self.rollout.margins
        # A vehicle that is in the way even if it keeps its distance is in the way elsewhere. The braking is late before
        # the plan loses its room: the tolerances of a frame reduce the distance of a braking vehicle only afterwards.
        too_near = (at_once < NEW_PATH_MARGIN) & (believed >= CLEAR)
        late = {b for i, b in enumerate(seen.identities) if too_near[i] and self.stays.get(b, -1.0) >= CLEAR}
        return np.where(at_once < CLEAR, at_once, believed), late

    def _margins(self, manoeuvre: EgoManoeuvre, others: NetworkVehicles) -> FloatArray:
        """Separation of the vehicles with a distance obligation from the path of a candidate, if they brake at once,
        (m,) [m]; inf for the others."""
        owing, out = np.flatnonzero(others.obliged.any(axis=1)), np.full(len(others.obliged), np.inf)
        if owing.size:
            self._fit(others)
            row = np.array(manoeuvre, float)
            try_with_braking(self.alone, self.road, self.body, others, row, self.rollout, self.bodies)
            out[owing] = self.rollout.margins[owing]
        return out

    def _fit(self, others: NetworkVehicles) -> None:
        """Enlarge or reduce the rollout buffer to the number of vehicles."""
        if len(self.rollout.margins) != len(others.obliged):
            self.rollout = empty_rollout(len(self.rollout.path) - 1, len(self.rollout.boxes), len(others.obliged))
