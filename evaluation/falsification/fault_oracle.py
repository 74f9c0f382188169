"""Check of the guarantee of `shield.certificate.network` in every frame: which vehicle came how near to the ego.

The guarantee: a vehicle either breaks a rule, and the monitor records that in the same frame, or it stays outside the
ego's buffer. So the oracle counts the clearance of vehicles without a recorded violation. Counting starts with the
first verified decision. It pauses after a disturbance: a violator in the way of the verified plan, a new wreck, or a
wreck that is being pushed. A vehicle that must keep its distance from the ego may enter the buffer; for it the
bodies count.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.state import FloatArray
from dynamics.traffic.assumptions import Assumptions
from dynamics.traffic.rules_of_the_road import footprint, gap_between
from evaluation.falsification.network_adversaries import FAIL_SAFE
from shield.certificate.network.monitor import NetworkRule
from shield.config import Buffer
from shield.decision import Decision
from shield.filters.network import NetworkFilter

__all__ = ["BUFFER", "FaultOracle"]

BUFFER = Buffer()
"""Buffer of the ego in this check, independent of the shield's; a vehicle inside it has intruded."""
_RULES = Assumptions.roads()
_SHRINKS = 1e-6
"""Decrease of a margin beyond rounding [m]."""


class FaultOracle:
    """Observes every frame: the clearance of each vehicle, and one frame later the violators among them.

    Parameters
    ----------
    base : the unwrapped environment; its road's `step` is replaced.
    network_filter : the filter on road networks; its `frame` is replaced.
    """

    def __init__(self, base: Any, network_filter: NetworkFilter) -> None:
        self._base, self._network_filter, self._step, self._filter_frame = (
            base,
            network_filter,
            base.road.step,
            network_filter.frame,
        )
        self._near: list[tuple[Any, int, float, float]] = []
        self._promised, self._crashes, self.frames, self.counted = (
            False,
            network_filter.by_rule.get(NetworkRule.CRASH, 0),
            0,
            0,
        )
        self.clearance, self.near, self.nearest_vehicle, self.when = np.inf, np.inf, -1, -1
        self.margin, self.shrunk = np.inf, 0
        base.road.step = self._watched
        network_filter.frame = self._observed_frame  # type: ignore[method-assign]

    @property
    def over(self) -> bool:
        """Whether nothing that follows can count."""
        return (
            bool(self._base.vehicle.crashed)
            or self.clearance < 0
            or NetworkRule.UNFORESEEN in self._network_filter.watch.by_rule
        )

    def settle(self, named: set[Any]) -> None:
        """Count the vehicles that were near in the last frame, except the violators in `named`."""
        for body, place, gap, left in self._near:
            if body in named:
                continue
            self.near = min(self.near, left)
            if gap < self.clearance:
                self.clearance, self.nearest_vehicle, self.when = gap, place, self.frames
        self._near = []

    def _observed_frame(self) -> tuple[Any, Decision]:
        before = self._network_filter.watch.last
        command, decision = self._filter_frame()
        named = self._network_filter.watch.culprits
        self.settle(named)
        less = {body: now for body, (then, now) in self._network_filter.kept.items() if now < then - _SHRINKS}
        if less and before is not None and self._promised:
            compliant = less.keys() - named - self._network_filter.have_broken(less, before)
            self.shrunk += bool(compliant)
            self.margin = min(self.margin, *(less[body] for body in compliant), np.inf)
        crashes = self._network_filter.by_rule.get(NetworkRule.CRASH, 0)
        # Two vehicles that have crashed slide, and push each other while they overlap. The monitor no longer counts
        # them as violators.
        pushed = any(body.crashed and body.impact is not None for body in self._base.road.vehicles)
        disturbed = self._network_filter.disturbed or crashes > self._crashes or pushed
        if decision.tier.verified or disturbed:
            self._promised = decision.tier.verified
        self._crashes = crashes
        return command, decision

    def _watched(self, dt: float) -> None:
        base, ego = self._base, self._base.vehicle
        was_over = self.over
        sound = [(k, b) for k, b in enumerate(base.road.vehicles) if b is not ego and not b.crashed]
        owing = {body for _, body in sound if self._network_filter.has_distance_obligation(body)}
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
            self.settle(self._network_filter.culprits(hit) | self._network_filter.watch.culprits)


def _row(body: Any) -> list[float]:
    speed = float(getattr(body, "speed", 0.0))
    return [*body.position, body.heading, speed, body.LENGTH, body.WIDTH, 0.0]


def _gap(rows: FloatArray, i: int, owing: bool) -> float:
    """Distance of vehicle i from the ego, row 0, with the ego's buffer unless `owing` [m]."""
    buffer = Buffer(0.0, 0.0) if owing else BUFFER
    mine = footprint(rows[0], buffer.longitudinal, buffer.lateral)
    return float(gap_between(mine, mine.along, mine.across, rows, i, 0.0))


def _left(gap: float, speed: float, ego: float) -> float:
    """Rest of a gap once a follower has braked as it must, and the ego as hard as it can [m]; speeds [m/s]."""
    v = max(speed, 0.0)
    return gap - v * _RULES.reaction_time - v**2 / (2 * _RULES.follower_braking) + ego**2 / (2 * FAIL_SAFE)
