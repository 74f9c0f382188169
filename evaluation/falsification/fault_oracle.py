"""The claim of `shield.certificate.network`, checked frame by frame: which vehicle comes how near to a shielded ego.

Whatever the others do is named by the monitor in the frame in which it breaks a rule, or brings nobody nearer to the
ego than its buffer. So what counts is how near those come whom the monitor has not named, from when something is
verified, and as long as nobody named has been in the way of it, nor a wreck that was none before or is being pushed.
Whoever owes the ego its distance may come into its buffer; of it the bodies count.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.state import FloatArray
from dynamics.traffic.assumptions import Assumptions
from dynamics.traffic.rules_of_the_road import footprint, gap_between
from evaluation.falsification.network_adversaries import FAIL_SAFE
from shield.certificate.network.monitor import Breach
from shield.config import Buffer
from shield.decision import Decision
from shield.filters.network import RoadDoor

__all__ = ["BUFFER", "Referee"]

BUFFER = Buffer()
"""Whoever comes nearer to the ego has breached it, whatever the shield is told."""
_RULES = Assumptions.roads()
_SHRINKS = 1e-6
"""By so much a margin has become less, and not by rounding [m]."""


class Referee:
    """Sees every frame: how near whom comes, and whom the monitor has named of them, a frame later."""

    def __init__(self, base: Any, door: RoadDoor) -> None:
        self._base, self._door, self._step, self._ask = base, door, base.road.step, door.frame
        self._near: list[tuple[Any, int, float, float]] = []
        self._promised, self._crashes, self.frames, self.counted = False, door.by_rule.get(Breach.CRASH, 0), 0, 0
        self.clearance, self.near, self.who, self.when = np.inf, np.inf, -1, -1
        self.margin, self.shrunk = np.inf, 0
        base.road.step = self._watched
        door.frame = self._asked  # type: ignore[method-assign]

    @property
    def over(self) -> bool:
        """Whether there is nothing more to be seen."""
        return bool(self._base.vehicle.crashed) or self.clearance < 0 or Breach.UNFORESEEN in self._door.watch.by_rule

    def settle(self, named: set[Any]) -> None:
        """Count those who were near when last seen and have not been named."""
        for body, place, gap, left in self._near:
            if body in named:
                continue
            self.near = min(self.near, left)
            if gap < self.clearance:
                self.clearance, self.who, self.when = gap, place, self.frames
        self._near = []

    def _asked(self) -> tuple[Any, Decision]:
        before = self._door.watch.last
        command, decision = self._ask()
        named = self._door.watch.culprits
        self.settle(named)
        less = {body: now for body, (then, now) in self._door.kept.items() if now < then - _SHRINKS}
        if less and before is not None and self._promised:
            innocent = less.keys() - named - self._door.have_broken(less, before)
            self.shrunk += bool(innocent)
            self.margin = min(self.margin, *(less[body] for body in innocent), np.inf)
        crashes = self._door.by_rule.get(Breach.CRASH, 0)
        # Two that have crashed into one another slide, and are pushed as long as they overlap: they are no longer among
        # those who offend.
        pushed = any(body.crashed and body.impact is not None for body in self._base.road.vehicles)
        disturbed = self._door.disturbed or crashes > self._crashes or pushed
        if decision.tier.verified or disturbed:
            self._promised = decision.tier.verified
        self._crashes = crashes
        return command, decision

    def _watched(self, dt: float) -> None:
        base, ego = self._base, self._base.vehicle
        was_over = self.over
        sound = [(k, b) for k, b in enumerate(base.road.vehicles) if b is not ego and not b.crashed]
        owing = {body for _, body in sound if self._door.is_owed_by(body)}
        self._step(dt)
        self.frames += 1
        if was_over or not self._promised:
            return
        self.counted += 1
        bodies = [*sound, *((-1, thing) for thing in base.road.objects)]
        rows = np.array([_row(ego), *(_row(body) for _, body in bodies)])
        for i, (place, body) in enumerate(bodies, start=1):
            gap = _gap(rows, i, body in owing)
            self._near.append((body, place, gap, _left(gap, *rows[[i, 0], 3]) if body in owing else gap))
        if ego.crashed:
            hit = {body for _, body in sound if body.crashed}
            self.settle(self._door.culprits(hit) | self._door.watch.culprits)


def _row(body: Any) -> list[float]:
    speed = float(getattr(body, "speed", 0.0))
    return [*body.position, body.heading, speed, body.LENGTH, body.WIDTH, 0.0]


def _gap(rows: FloatArray, i: int, owing: bool) -> float:
    """Of the ego, the first of the rows, with its buffer or without, from vehicle i [m]."""
    buffer = Buffer(0.0, 0.0) if owing else BUFFER
    mine = footprint(rows[0], buffer.longitudinal, buffer.lateral)
    return float(gap_between(mine, mine.along, mine.across, rows, i, 0.0))


def _left(gap: float, speed: float, ego: float) -> float:
    """What is left of a gap when one that follows the ego brakes as it owes it, and the ego as hard as it can [m]."""
    v = max(speed, 0.0)
    return gap - v * _RULES.reaction_time - v**2 / (2 * _RULES.follower_braking) + ego**2 / (2 * FAIL_SAFE)
