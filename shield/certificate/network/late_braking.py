"""Who owed the ego its distance on a road network, could have kept it by braking, and no longer can."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.road_networks.simulation.ego_alone import Alone, Course
from dynamics.state import FloatArray
from shield.certificate.network.choice import ask, try_course
from shield.certificate.network.clearance import CLEAR, MADE
from shield.certificate.network.mitigation import bare
from shield.certificate.network.monitor import Seen
from shield.certificate.network.workspace import Body, Others, Road, Trial, empty_trial

__all__ = ["Braking"]


@dataclass(slots=True, eq=False)
class Braking:
    """How far those who owe the ego their distance stay from its body, if they brake at once.

    Attributes
    ----------
    alone, road : of the ego. body : of it without its buffer. trial, bodies : room, see `choose`.
    stays : of each who owed it when `remember` was called [m].
    """

    alone: Alone
    road: Road
    body: Body
    trial: Trial
    bodies: Trial
    stays: dict[Any, float]

    @classmethod
    def on(cls, alone: Alone, road: Road, frames: int, stays: dict[Any, float]) -> Braking:
        """On a road, for paths of so many frames; what is known of who owed before."""
        lanes = len(road.ways.over)
        return cls(alone, road, bare(road).body, empty_trial(frames, lanes, 0), empty_trial(frames, lanes, 0), stays)

    def remember(self, course: Course, who: list[Any], others: Others) -> None:
        """Where the ego goes on with a course, who owes it its distance, and how far they stay."""
        margins = self._margins(course, others)
        self.stays = {who[i]: float(margins[i]) for i in np.flatnonzero(others.owes.any(axis=1))}

    def now(self, course: Course, seen: Seen) -> tuple[FloatArray, set[Any]]:
        """How far that course, a frame later, stays from each of the others, (m,) [m]; and who could have kept its
        distance when it was remembered, and no longer can: nobody is believed to keep what it cannot."""
        at_once = self._margins(course, seen.others)
        self._fit(seen.others)
        try_course(self.alone, self.road, seen.others, np.array(course, float), True, self.trial)
        believed = self.trial.margins
        # Who is in the way although it is believed to keep its distance is so elsewhere. It is late before the plan
        # suffers: what the tolerances of a frame take from the distance of one that brakes comes after.
        too_near = (at_once < MADE) & (believed >= CLEAR)
        late = {b for i, b in enumerate(seen.who) if too_near[i] and self.stays.get(b, -1.0) >= CLEAR}
        return np.where(at_once < CLEAR, at_once, believed), late

    def _margins(self, course: Course, others: Others) -> FloatArray:
        """How far those who owe the ego their distance stay from it on a course, (m,) [m]; inf of the rest."""
        owing, out = np.flatnonzero(others.owes.any(axis=1)), np.full(len(others.owes), np.inf)
        if owing.size:
            self._fit(others)
            row = np.array(course, float)
            ask(self.alone, self.road, self.body, others, row, self.trial, self.bodies)
            out[owing] = self.trial.margins[owing]
        return out

    def _fit(self, others: Others) -> None:
        """Room for as many."""
        if len(self.trial.margins) != len(others.owes):
            self.trial = empty_trial(len(self.trial.path) - 1, len(self.trial.boxes), len(others.owes))
