"""Where the others can be on a network of roads, as polygons in the world: what pictures of the worst case shade."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.road_networks.geometry.road_geometry import RoadGeometry
from dynamics.state import FloatArray
from evaluation.report.draw import AHEAD
from shield.certificate.network.workspace import Foreseen
from shield.filters.network import RoadDoor

__all__ = ["ReachableAreas", "strip_outline"]

_LEAST = 0.1
"""Shorter pieces of a lane are not drawn [m]."""


class ReachableAreas:
    """The places of the others that a decision on a network of roads went by, at the times that are drawn.

    Parameters
    ----------
    base : the environment, unwrapped, after a reset. It is read again where its road is another.
    """

    def __init__(self, base: Any) -> None:
        self._base, self._network = base, None
        self._geometry: RoadGeometry

    def now(self, filters: Any) -> tuple[tuple[FloatArray, ...], ...]:
        """Outlines (n, 2) [m] at each of the times of `draw.AHEAD`, from the last frame that was decided on.

        Parameters
        ----------
        filters : what filters, such as `ShieldedEnv.door`; nothing is drawn where it is no `RoadDoor`, or could not
            read its scene.
        """
        if not isinstance(filters, RoadDoor) or filters.cause:
            return ()
        if self._base.road.network is not self._network:
            self._network, self._geometry = self._base.road.network, RoadGeometry.of(self._base)
        foreseen, dt = filters.foreseen, 1.0 / self._base.config["simulation_frequency"]
        frames = foreseen.most.shape[1]
        return tuple(
            tuple(
                outline
                for j in range(len(foreseen.lanes))
                if (outline := strip_outline(self._geometry, foreseen, j, frame, frame)) is not None
            )
            for frame in (min(round(ahead / dt), frames - 1) for ahead in AHEAD)
        )


def strip_outline(geometry: RoadGeometry, foreseen: Foreseen, j: int, first: int, last: int) -> FloatArray | None:
    """Where strip `j` has its vehicle's body from frame `first` to `last`: an outline (n, 2) in the world [m]; None
    where that is nowhere on its lane."""
    lane = geometry.number(foreseen.lanes[j])
    near, far = max(foreseen.least[j, first], 0.0), min(foreseen.most[j, last], float(geometry.lengths[lane]))
    if not far - near > _LEAST:
        return None
    return np.asarray(geometry.outline(lane, near, far, foreseen.low[j], foreseen.high[j]))
