"""Reachable areas of other vehicles on a road network, as polygons in the world frame, for worst-case pictures."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.road_networks.geometry.road_geometry import RoadGeometry
from dynamics.state import FloatArray
from evaluation.report.draw import AHEAD
from shield.certificate.network.workspace import NetworkPrediction
from shield.filters.network import NetworkFilter

__all__ = ["ReachableAreas", "interval_outline"]

_LEAST = 0.1
"""Least length of a piece of lane that is drawn [m]."""


class ReachableAreas:
    """Reachable lane intervals of other vehicles in a decision on a road network, at the drawn times.

    Parameters
    ----------
    base : the unwrapped environment, after a reset. Its road is read again if it has changed.
    """

    def __init__(self, base: Any) -> None:
        self._base, self._network = base, None
        self._geometry: RoadGeometry

    def now(self, filters: Any) -> tuple[tuple[FloatArray, ...], ...]:
        """Outlines (n, 2) [m] at each of the times `draw.AHEAD`, from the last verified frame.

        Parameters
        ----------
        filters : the filter, such as `ShieldedEnv.filter`. The result is empty if it is no `NetworkFilter`, or
            could not read its scene.
        """
        if not isinstance(filters, NetworkFilter) or filters.cause:
            return ()
        if self._base.road.network is not self._network:
            self._network, self._geometry = self._base.road.network, RoadGeometry.of(self._base)
        foreseen, dt = filters.foreseen, 1.0 / self._base.config["simulation_frequency"]
        frames = foreseen.most.shape[1]
        return tuple(
            tuple(
                outline
                for j in range(len(foreseen.lanes))
                if (outline := interval_outline(self._geometry, foreseen, j, frame, frame)) is not None
            )
            for frame in (min(round(ahead / dt), frames - 1) for ahead in AHEAD)
        )


def interval_outline(
    geometry: RoadGeometry, foreseen: NetworkPrediction, j: int, first: int, last: int
) -> FloatArray | None:
    """Outline of a reachable lane interval, with the vehicle's body.

    Parameters
    ----------
    geometry : lanes of the road.
    foreseen : reachable lane intervals of a decision.
    j : index of the interval.
    first, last : range of frames.

    Returns
    -------
    The outline (n, 2) in the world frame [m]; None if the interval has no place on its lane.
    """
    lane = geometry.number(foreseen.lanes[j])
    near, far = max(foreseen.least[j, first], 0.0), min(foreseen.most[j, last], float(geometry.lengths[lane]))
    if not far - near > _LEAST:
        return None
    return np.asarray(geometry.outline(lane, near, far, foreseen.low[j], foreseen.high[j]))
