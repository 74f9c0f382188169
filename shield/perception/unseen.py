"""Unseen vehicles: positions beyond the edges of sight that are consistent with earlier observations.

An observation leaves out vehicles beyond an edge. The edge ahead is the ego's range of sight, and the edge behind the
observed range. If all rows are full, the furthest row is an edge as well.

*Ahead*: in each lane the slowest permitted vehicle is assumed right behind the edge. A vehicle that comes into sight is
at that distance or further away.

*Behind*: a vehicle that the ego has passed is where it can have moved to since. A vehicle that was never seen is beyond
the edge, and no nearer than it can have come since the reset.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dynamics.compiled import kernel_no_refcount
from dynamics.deprecation import accept_former_fields
from dynamics.roads.straight import nearest
from dynamics.state import FloatArray, RoadState
from shield.errors import ConfigError
from shield.perception.sighting import DecodedObservation
from shield.perception.spec import ObservationSpec

__all__ = ["Unseen", "UnseenBehind", "edges", "unseen_ahead"]

_S, _R, _SPEED = int(RoadState.S), int(RoadState.R), int(RoadState.SPEED)
_GAP = 0.5
"""Gap between an unseen vehicle and a nearer visible one in its lane [m]."""
_BESIDE = 6.0
"""A newcomer from behind counts as a vehicle passed before if it is at most this far from its possible positions
[m]."""


@accept_former_fields({"room": "clear_behind", "surge": "speed_gain", "strays": "may_change_lanes"})
@dataclass(frozen=True, slots=True)
class Unseen:
    """Assumptions about unseen vehicles.

    Attributes
    ----------
    slowest : least speed of unseen vehicles ahead [m/s]. A slower visible vehicle lowers it.
    fastest : greatest speed of a vehicle never seen that approaches from behind [m/s].
    clear_behind : at the reset no unseen vehicle is nearer behind the ego than this [m].
    speed_gain : greatest increase of the speed of a passed vehicle since it was last seen [m/s].
    acceleration : acceleration of that increase [m/s^2].
    may_change_lanes : whether a passed vehicle may have changed lanes since.

    Raises
    ------
    ConfigError
        If a number is negative or not finite, or `slowest` is above `fastest`.
    """

    slowest: float = 18.0
    fastest: float = 30.0
    clear_behind: float = 200.0
    speed_gain: float = 1.0
    acceleration: float = 3.0
    may_change_lanes: bool = False

    def __post_init__(self) -> None:
        for name in ("slowest", "fastest", "clear_behind", "speed_gain", "acceleration"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < np.inf:
                raise ConfigError(f"Unseen.{name} must be a finite number from 0 on, got {value!r}")
        if self.slowest > self.fastest:
            raise ConfigError(f"Unseen.slowest ({self.slowest}) is above fastest ({self.fastest})")

    @classmethod
    def worst(cls) -> Unseen:
        """Least restrictive assumptions: a vehicle may be right beyond each edge of sight at any time, standing ahead,
        and at 40 m/s behind."""
        return cls(
            slowest=0.0, fastest=40.0, clear_behind=0.0, speed_gain=40.0, acceleration=1e3, may_change_lanes=True
        )


def edges(spec: ObservationSpec, sighting: DecodedObservation) -> tuple[float, float]:
    """Distance ahead and behind within which every vehicle is seen, from centre to centre [m]."""
    far, back = spec.sight
    if sighting.full or sighting.cut:
        # Rows are sorted by distance along the road; a vehicle that is left out is at least as far as the last row.
        furthest = float(np.abs(sighting.others[:, 0]).max(initial=0.0))
        if not spec.sorted or sighting.cut:
            furthest = float(spec.body[0])
        far, back = min(far, furthest), min(back, furthest)
    return far, back


def unseen_ahead(
    spec: ObservationSpec, far: float, unseen: Unseen, road: Any, ego: FloatArray, others: FloatArray
) -> FloatArray:
    """Road states of vehicles that may be beyond the edge ahead, (lanes, 4); (0, 4) where the ego sees as far as
    `spec.distance`.

    Parameters
    ----------
    far : the edge [m]. ego, others : road states, (4,) and (m, 4).
    """
    if far >= spec.distance:
        return np.zeros((0, 4))
    found = np.zeros((len(road.centers), 4))
    _beyond(road.centers, others, float(ego[RoadState.S]), far, spec.body[0], unseen.slowest, found)
    return found


@kernel_no_refcount
def _beyond(
    lanes: FloatArray, others: FloatArray, s: float, far: float, length: float, slowest: float, found: FloatArray
) -> None:
    """Fill in the state of an unseen vehicle for each lane, `found` (lanes, 4); `length` is that of a body [m]."""
    for i in range(len(others)):
        slowest = min(slowest, others[i, _SPEED])
    for k in range(len(lanes)):
        found[k, _S], found[k, _R], found[k, _SPEED] = s + far, lanes[k], slowest
    for i in range(len(others)):
        k = nearest(lanes, others[i, _R])
        if s <= others[i, _S] < s + far + length:
            # Bodies do not overlap: the unseen vehicle is beyond the visible ones of its lane.
            found[k, _S] = max(found[k, _S], others[i, _S] + length + _GAP)


@dataclass(slots=True)
class UnseenBehind:
    """Vehicles that may be beyond the edge behind, from one observation to the next.

    Attributes
    ----------
    passed : vehicles that the ego has passed, (n, 4): greatest position relative to the ego [m], lateral position [m],
        speed and greatest future speed [m/s].
    nearest_unseen : greatest position of a vehicle never seen, relative to the ego, below 0 [m]; NaN before the first
        observation.
    """

    passed: FloatArray = field(default_factory=lambda: np.zeros((0, 4)))
    nearest_unseen: float = float("nan")

    def go_on(
        self, unseen: Unseen, back: float, ego_speed: float, passed: float, lost: FloatArray, new: FloatArray
    ) -> None:
        """Update with one more observation.

        Parameters
        ----------
        back : the edge [m]. ego_speed : along the road [m/s]. passed : time since the previous observation [s].
        lost, new : vehicles that went out of sight, and that came into sight, (n, 3): distance ahead of the ego [m],
            lateral position [m], and speed along the road [m/s].
        """
        if np.isnan(self.nearest_unseen):
            self.nearest_unseen = -unseen.clear_behind
        else:
            self.nearest_unseen += (unseen.fastest - ego_speed) * passed
        pool = self.passed
        if not (len(pool) or len(lost)):
            self.nearest_unseen = min(self.nearest_unseen, -back)
            return
        pool[:, 2] = np.minimum(pool[:, 2] + unseen.acceleration * passed, pool[:, 3])
        pool[:, 0] += (pool[:, 2] - ego_speed) * passed
        for ahead_by, r, _ in new[new[:, 0] < 0]:
            away = np.abs(pool[:, 1] - r) + np.maximum(ahead_by - pool[:, 0], 0.0)
            if away.min(initial=np.inf) < _BESIDE:
                pool = np.delete(pool, away.argmin(), axis=0)
        gone = lost[lost[:, 0] < 0]
        if len(gone):
            pool = np.concatenate([pool, np.column_stack([gone, gone[:, 2] + unseen.speed_gain])])
        # A nearer vehicle would be seen.
        self.nearest_unseen = min(self.nearest_unseen, -back)
        pool[:, 0] = np.minimum(pool[:, 0], -back)
        self.passed = pool

    def states(self, unseen: Unseen, road: Any, ego: FloatArray, reach: float) -> FloatArray:
        """Road states of vehicles that may be behind, (n, 4), at most `reach` behind the ego [m]."""
        s, lanes = float(ego[RoadState.S]), road.centers
        rows = [(s + self.nearest_unseen, r, 0.0, unseen.fastest) for r in lanes if self.nearest_unseen > -reach]
        beside = (1.5 if unseen.may_change_lanes else 0.5) * road.width
        rows += [
            (s + gap, center, 0.0, speed)
            for gap, r, speed, _ in self.passed
            for center in lanes
            if gap > -reach and abs(center - r) <= beside
        ]
        return np.array(rows, float).reshape(-1, 4)
