"""Who owed the ego its distance on a road network, could have kept it by braking, and no longer can."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.networks.alone import Alone, Course
from dynamics.state import FloatArray
from shield.roads.choosing import CLEAR, try_course
from shield.roads.room import Others, Road, Trial, empty_trial
from shield.roads.watch import Seen

__all__ = ["Braking"]


@dataclass(slots=True, eq=False)
class Braking:
    """How far those who owe the ego their distance stay from its body, if they brake at once.

    Attributes
    ----------
    alone, road : of the ego, without its buffer and with nobody's time to react. trial : written.
    stays : of each who owed it when `remember` was called [m].
    """

    alone: Alone
    road: Road
    trial: Trial
    stays: dict[Any, float]

    @classmethod
    def on(cls, alone: Alone, road: Road, frames: int, stays: dict[Any, float]) -> Braking:
        """On a road without a buffer, for paths of so many frames; what is known of who owed before."""
        at_once = road._replace(duty=road.duty._replace(reaction=0))
        return cls(alone, at_once, empty_trial(frames, len(road.ways.over), 0), stays)

    def remember(self, course: Course, who: list[Any], others: Others) -> None:
        """Where the ego goes on with a course, who owes it its distance, and how far they stay."""
        owing = np.flatnonzero(others.owes.any(axis=1))
        margins = self._margins(course, others, len(who)) if owing.size else np.empty(0)
        self.stays = {who[i]: float(margins[i]) for i in owing}

    def late(self, course: Course, seen: Seen) -> set[Any]:
        """Who could have kept its distance on that course when it was remembered, a frame ago, and no longer can."""
        if not self.stays:
            return set()
        now = self._margins(course, seen.others, len(seen.who))
        return {b for i, b in enumerate(seen.who) if self.stays.get(b, -1.0) >= CLEAR and now[i] < CLEAR}

    def _margins(self, course: Course, others: Others, count: int) -> FloatArray:
        """The least distance of each of so many others, (count,) [m]."""
        if len(self.trial.margins) != count:
            self.trial = empty_trial(len(self.trial.path) - 1, len(self.trial.boxes), count)
        try_course(self.alone, self.road, others, np.array(course, float), False, self.trial)
        return self.trial.margins
