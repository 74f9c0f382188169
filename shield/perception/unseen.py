"""Who may be there unseen: phantoms beyond the edges of sight, as far as what was seen before leaves room for them.

What an observation leaves out is beyond an edge: further than the ego sees, further behind than it is shown, or further
than the furthest of those shown where more may be there than there are rows.

*Ahead*, in each lane, the slowest that may be is assumed right behind the edge: whoever comes into sight is further
away, or the same. *Behind*, those that the ego has passed are where they can have come to since, and whoever has never
been seen is no nearer than it can have come since the reset, and beyond the edge.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dynamics.compiled import uncounted
from dynamics.roads.straight import nearest
from dynamics.state import FloatArray, RoadState
from shield.errors import ConfigError
from shield.perception.sighting import Sighting
from shield.perception.spec import ObservationSpec

__all__ = ["Behind", "Unseen", "ahead", "edges"]

_S, _R, _SPEED = int(RoadState.S), int(RoadState.R), int(RoadState.SPEED)
_GAP = 0.5
"""From a phantom to whoever is seen in its lane nearer to the ego [m]."""
_BESIDE = 6.0
"""Whoever comes up from behind, no further than this from where one that was passed can be, is that one [m]."""


@dataclass(frozen=True, slots=True)
class Unseen:
    """What is assumed of those who are not seen.

    Attributes
    ----------
    slowest : nobody unseen ahead drives slower [m/s], but where somebody is seen who does.
    fastest : nobody who has never been seen comes up from behind faster [m/s].
    room : nobody unseen is nearer behind the ego at the reset [m].
    surge : by how much one that was passed may come to drive faster than it did when it was seen last [m/s].
    acceleration : how fast it comes to do so [m/s^2].
    strays : whether it may have changed lanes since.

    Raises
    ------
    ConfigError
        If one is no number from 0 on, or `slowest` is above `fastest`.
    """

    slowest: float = 18.0
    fastest: float = 30.0
    room: float = 200.0
    surge: float = 1.0
    acceleration: float = 3.0
    strays: bool = False

    def __post_init__(self) -> None:
        for name in ("slowest", "fastest", "room", "surge", "acceleration"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < np.inf:
                raise ConfigError(f"Unseen.{name} must be a finite number from 0 on, got {value!r}")
        if self.slowest > self.fastest:
            raise ConfigError(f"Unseen.slowest ({self.slowest}) is above fastest ({self.fastest})")

    @classmethod
    def worst(cls) -> Unseen:
        """Anybody may be right beyond each edge of sight at any time: standing ahead, at 40 m/s behind."""
        return cls(slowest=0.0, fastest=40.0, room=0.0, surge=40.0, acceleration=1e3, strays=True)


def edges(spec: ObservationSpec, sighting: Sighting) -> tuple[float, float]:
    """How far ahead and behind, from centre to centre, everybody is seen [m]."""
    far, back = spec.sight
    if sighting.full or sighting.cut:
        # Rows are sorted by how far each is along the road; who is left out is no nearer than the last.
        furthest = float(np.abs(sighting.others[:, 0]).max(initial=0.0))
        if not spec.sorted or sighting.cut:
            furthest = float(spec.body[0])
        far, back = min(far, furthest), min(back, furthest)
    return far, back


def ahead(
    spec: ObservationSpec, far: float, unseen: Unseen, road: Any, ego: FloatArray, others: FloatArray
) -> FloatArray:
    """States on the road of those who may be there beyond the edge ahead, (lanes, 4); nobody where the ego sees as far
    as it can.

    Parameters
    ----------
    far : the edge [m]. ego, others : states on the road, (4,) and (m, 4).
    """
    if far >= spec.distance:
        return np.zeros((0, 4))
    found = np.zeros((len(road.centers), 4))
    _beyond(road.centers, others, float(ego[RoadState.S]), far, spec.body[0], unseen.slowest, found)
    return found


@uncounted
def _beyond(
    lanes: FloatArray, others: FloatArray, s: float, far: float, length: float, slowest: float, found: FloatArray
) -> None:
    for i in range(len(others)):
        slowest = min(slowest, others[i, _SPEED])
    for k in range(len(lanes)):
        found[k, _S], found[k, _R], found[k, _SPEED] = s + far, lanes[k], slowest
    for i in range(len(others)):
        k = nearest(lanes, others[i, _R])
        if s <= others[i, _S] < s + far + length:
            # Bodies do not overlap: whoever is there is beyond those seen in its lane.
            found[k, _S] = max(found[k, _S], others[i, _S] + length + _GAP)


@dataclass(slots=True)
class Behind:
    """Who may be behind the edge, from one observation to the next.

    Attributes
    ----------
    passed : of each that was passed how far it is ahead of the ego at most, where it is across the road, and how fast
        it is and comes to be at most, (n, 4) [m], [m], [m/s], [m/s].
    stranger : how far ahead of the ego whoever has never been seen is at most, below 0 [m]; NaN before the first.
    """

    passed: FloatArray = field(default_factory=lambda: np.zeros((0, 4)))
    stranger: float = float("nan")

    def go_on(
        self, unseen: Unseen, back: float, ego_speed: float, passed: float, lost: FloatArray, new: FloatArray
    ) -> None:
        """Take in one more observation.

        Parameters
        ----------
        back : the edge [m]. ego_speed : along the road [m/s]. passed : time since the observation before [s].
        lost : of those who have got out of sight, and new : of those who have come into it: how far ahead of the ego,
            where across the road, and how fast along it, (n, 3).
        """
        if np.isnan(self.stranger):
            self.stranger = -unseen.room
        else:
            self.stranger += (unseen.fastest - ego_speed) * passed
        pool = self.passed
        if not (len(pool) or len(lost)):
            self.stranger = min(self.stranger, -back)
            return
        pool[:, 2] = np.minimum(pool[:, 2] + unseen.acceleration * passed, pool[:, 3])
        pool[:, 0] += (pool[:, 2] - ego_speed) * passed
        for ahead_by, r, _ in new[new[:, 0] < 0]:
            away = np.abs(pool[:, 1] - r) + np.maximum(ahead_by - pool[:, 0], 0.0)
            if away.min(initial=np.inf) < _BESIDE:
                pool = np.delete(pool, away.argmin(), axis=0)
        gone = lost[lost[:, 0] < 0]
        if len(gone):
            pool = np.concatenate([pool, np.column_stack([gone, gone[:, 2] + unseen.surge])])
        # Whoever were nearer would be seen.
        self.stranger = min(self.stranger, -back)
        pool[:, 0] = np.minimum(pool[:, 0], -back)
        self.passed = pool

    def states(self, unseen: Unseen, road: Any, ego: FloatArray, reach: float) -> FloatArray:
        """States on the road of those who may be there, (n, 4), no further than `reach` behind the ego [m]."""
        s, lanes = float(ego[RoadState.S]), road.centers
        rows = [(s + self.stranger, r, 0.0, unseen.fastest) for r in lanes if self.stranger > -reach]
        beside = (1.5 if unseen.strays else 0.5) * road.width
        rows += [
            (s + gap, center, 0.0, speed)
            for gap, r, speed, _ in self.passed
            for center in lanes
            if gap > -reach and abs(center - r) <= beside
        ]
        return np.array(rows, float).reshape(-1, 4)
