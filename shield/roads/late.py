"""Who owed the ego its distance on a road network, could have kept it by braking, and no longer can."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.networks.alone import Alone, Course
from dynamics.state import FloatArray
from shield.roads.choosing import CLEAR, ask
from shield.roads.room import Others, Road, Trial, empty_trial
from shield.roads.saving import bare
from shield.roads.survey import Body

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
        margins = self.margins(course, others)
        self.stays = {who[i]: float(margins[i]) for i in np.flatnonzero(others.owes.any(axis=1))}

    def late(self, margins: FloatArray, believed: FloatArray, who: list[Any]) -> set[Any]:
        """Who could have kept its distance when it was remembered, a frame ago, and no longer can: see `margins`. Who
        is in the way although it is `believed` to keep it, (m,) [m], is so elsewhere."""
        too_near = (margins < CLEAR) & (believed >= CLEAR)
        return {b for i, b in enumerate(who) if too_near[i] and self.stays.get(b, -1.0) >= CLEAR}

    def margins(self, course: Course, others: Others) -> FloatArray:
        """How far those who owe the ego their distance stay from it on a course, (m,) [m]; inf of the rest."""
        owing, out = np.flatnonzero(others.owes.any(axis=1)), np.full(len(others.owes), np.inf)
        if owing.size:
            if len(self.trial.margins) != len(out):
                self.trial = empty_trial(len(self.trial.path) - 1, len(self.trial.boxes), len(out))
            row = np.array(course, float)
            ask(self.alone, self.road, self.body, others, row, self.trial, self.bodies)
            out[owing] = self.trial.margins[owing]
        return out
