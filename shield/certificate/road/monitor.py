"""Monitor: whether the other vehicles keep to the assumptions, frame by frame.

Traffic has to keep to `dynamics.traffic.rules_of_the_road`; in a parking lot everything has to stand still.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.compiled import kernel_no_refcount
from dynamics.state import BoolArray, FloatArray, IntArray, Vehicle
from dynamics.traffic.occupancy import OtherVehicles
from dynamics.traffic.rules_of_the_road import EgoFootprint, RoadRule, gap_between, rule_violations
from dynamics.traffic.tables import VehicleTables

if TYPE_CHECKING:
    from shield.certificate.road.verify import PathVerifier

__all__ = ["ParkingMonitor", "RoadMonitor", "mark_touching", "update_obligations"]


_DISTANCE, _APPEARED = int(RoadRule.DISTANCE), int(RoadRule.APPEARED)


def _nobody() -> BoolArray:
    """An empty mask of vehicles."""
    return np.zeros(0, dtype=bool)


Separations = Callable[[], FloatArray]
"""Separation of the ego's fail-safe from the places that each vehicle can reach now, (m,) [m]; negative where they
overlap."""


@kernel_no_refcount
def update_obligations(
    obliged_before: Any, counted: Any, behind: Any, in_owned_lane: Any, broken: Any, grown: Any, obliged: Any
) -> tuple[bool, bool]:
    """Update the distance obligations, `obliged`, and add the distance rule to `grown` for two kinds of vehicles: those
    that had an obligation and have come beside the ego in an owned lane, and those that the stored plan relies on to
    brake, `counted`. Rules in `grown` are violated only where the fail-safe loses its room (`RuleViolations`).

    Parameters
    ----------
    obliged_before : vehicles with an obligation in the scene before, (m,). counted : see `PathVerifier.counted`, (m,).
    behind, in_owned_lane : see `RoadVehicles`, (m,). broken, grown : see `RuleViolations`, (m,). obliged : obligations
        now, (m,), written.

    Returns
    -------
    Whether any vehicle has violated a rule, and whether any has taken more room.
    """
    some, more = False, False
    for i in range(obliged_before.shape[0]):
        obliged[i] = behind[i] and in_owned_lane[i]
        if (obliged_before[i] and in_owned_lane[i] and not behind[i]) or counted[i]:
            grown[i] |= _DISTANCE
        some, more = some or broken[i] != 0, more or grown[i] != 0
    return some, more


@kernel_no_refcount
def mark_touching(ego: EgoFootprint, rows: FloatArray, period: float, grown: IntArray, broken: IntArray) -> bool:
    """Add the rules in `grown` to `broken` for vehicles that touch the ego's buffer now, or its body in the coming
    frame of `period` [s]: the fail-safe is judged from the next frame on. Return whether there is any."""
    some = False
    for i in range(grown.shape[0]):
        if grown[i] == 0:
            continue
        touches = gap_between(ego, ego.along, ego.across, rows, i, 0.0) < 0
        if touches or gap_between(ego, ego.body_along, ego.body_across, rows, i, period) <= 0:
            broken[i] |= grown[i]
            some = True
    return some


def appeared(new: BoolArray, rows: FloatArray, ego: EgoFootprint, broken: IntArray, grown: IntArray) -> None:
    """Check the new vehicles, (m,) bool: each has to leave the fail-safe its room, and violates a rule if it touches
    the ego's buffer. Its motion before is not known. `broken` and `grown` are written."""
    for i in np.flatnonzero(new).tolist():
        touches = gap_between(ego, ego.along, ego.across, rows, i, 0.0) < 0
        broken[i], grown[i] = (_APPEARED, 0) if touches else (0, _APPEARED)


def _rule_of(column: Vehicle) -> RoadRule:
    """The rule that a vehicle violates if this column of its row is not finite."""
    if column is Vehicle.SPEED:
        return RoadRule.SPEED
    return RoadRule.SIZE if column in (Vehicle.LENGTH, Vehicle.WIDTH) else RoadRule.WAY


@dataclass(frozen=True, slots=True, eq=False)
class RoadMonitor:
    """State of the monitor after one scene, for its m vehicles.

    Attributes
    ----------
    obliged : vehicles with a distance obligation towards the ego, (m,) bool.
    crashed : whether the ego had crashed.
    breaking : vehicles that violated a rule in that frame, (m,) bool.
    offenders : violators that may still be in the way of the ego's fail-safe, (m,) bool.
    count : number of violations so far. A vehicle that violates rules in consecutive frames counts once.
    by_rule : the same by rule.
    unreadable : ids of the vehicles with numbers that are not readable; they are in none of the arrays.
    """

    obliged: BoolArray = field(default_factory=_nobody)
    crashed: bool = False
    breaking: BoolArray = field(default_factory=_nobody)
    offenders: BoolArray = field(default_factory=_nobody)
    count: int = 0
    by_rule: Mapping[RoadRule, int] = field(default_factory=dict)
    unreadable: frozenset[int] = frozenset()

    @property
    def violated(self) -> bool:
        """Whether a violator may still be in the way."""
        return bool(self.offenders.any())

    @property
    def named(self) -> dict[str, int]:
        """`by_rule` by the names of the rules."""
        return {str(rule): count for rule, count in self.by_rule.items()}

    def forgiven(self) -> RoadMonitor:
        """The state without violators, for when a plan clears every vehicle again."""
        return replace(self, offenders=np.zeros(self.offenders.shape, dtype=bool)) if self.violated else self

    def with_unreadable(self, ids: IntArray, read: BoolArray, known: frozenset[int]) -> RoadMonitor:
        """The state with vehicles that are not readable: each violates the rules that check its unreadable numbers.

        Parameters
        ----------
        ids : of these vehicles, (n,). read : which of their numbers are readable, (n, 7).
        known : ids of those that were unreadable in the scene before, and have been counted.
        """
        count, by_rule = self.count, dict(self.by_rule)
        for i, row in zip(ids.tolist(), read, strict=True):
            if i in known:
                continue
            count += 1
            for rule in {_rule_of(Vehicle(column)) for column in np.flatnonzero(~row).tolist()}:
                by_rule[rule] = by_rule.get(rule, 0) + 1
        return replace(self, count=count, by_rule=by_rule, unreadable=frozenset(ids.tolist()))

    def of(self, same: IntArray | None, m: int) -> RoadMonitor:
        """The state for the m vehicles of the next scene, in their order.

        Parameters
        ----------
        same : index of each vehicle in the last scene, (m,), -1 for new ones; None if the order is the same.
        """
        if same is None and len(self.obliged) == m:
            return self
        flags = np.zeros((3, m), dtype=bool)
        if same is not None:
            known = same >= 0
            flags[:, known] = np.stack([self.obliged, self.breaking, self.offenders])[:, same[known]]
        return replace(self, obliged=flags[0], breaking=flags[1], offenders=flags[2])

    def next(
        self,
        verifier: PathVerifier,
        before: OtherVehicles | VehicleTables | None,
        new: BoolArray | None,
        counted: BoolArray,
        period: float,
        fail_safe: Separations,
    ) -> RoadMonitor:
        """State of the monitor one scene later; this state already has the vehicles of that scene, see `of`.

        Parameters
        ----------
        verifier : the scene, with what has been computed for its vehicles. Its surroundings refer to those of the scene
            before.
        before : the other vehicles in the scene before; None in the first scene, and where their states are estimates.
        new : vehicles that were not in the scene before, (m,) bool; None if there are none.
        counted : vehicles that the stored plan relies on to brake, (m,) bool. period : time since the scene before [s].
        fail_safe : called if a vehicle has taken more room than before.
        """
        behind, in_owned_lane, ego = verifier.behind, verifier.in_owned_lane, verifier.seen
        crashed = bool(verifier.scene.ego[Vehicle.CRASHED] > 0)
        if before is None:
            nobody = np.zeros(len(behind), dtype=bool)
            return RoadMonitor(behind & in_owned_lane, crashed, nobody, nobody, self.count, self.by_rule)
        if crashed:
            ego = ego._replace(crashed=not self.crashed, wrecked=True)
        broken, grown = rule_violations(before, verifier.around, period, self.obliged, ego)
        if new is not None:
            appeared(new, verifier.scene.others, ego, broken, grown)
        obliged = np.empty(len(broken), dtype=bool)
        some, more = update_obligations(self.obliged, counted, behind, in_owned_lane, broken, grown, obliged)
        if more:
            # A vehicle that takes more room than before has to leave the ego's fail-safe its room.
            mark_touching(ego, verifier.scene.others, verifier.scene.dt, grown, broken)
            broken |= np.where(fail_safe() >= 0, 0, grown)
            some = bool(broken.any())
        breaking = broken != 0
        if not some:
            return RoadMonitor(obliged, crashed, breaking, self.offenders, self.count, self.by_rule)
        count, by_rule = self.count, dict(self.by_rule)
        for i in np.flatnonzero(breaking & ~self.breaking):
            count += 1
            for rule in RoadRule(int(broken[i])):
                by_rule[rule] = by_rule.get(rule, 0) + 1
        return RoadMonitor(obliged, crashed, breaking, self.offenders | breaking, count, by_rule)


@dataclass(frozen=True, slots=True, eq=False)
class ParkingMonitor:
    """State of the monitor of a parking lot, where everything is assumed to stand. Unlike `RoadMonitor`, it clears no
    violation.

    Attributes
    ----------
    count : number of times that an obstacle has begun to move. violated : whether an obstacle moves now.
    moving : obstacles that moved in the last scene, (m,) bool, identified by their order.
    """

    count: int = 0
    violated: bool = False
    moving: BoolArray | None = None

    @property
    def named(self) -> dict[str, int]:
        """As of `RoadMonitor`."""
        return {"moving": self.count} if self.count else {}

    def next(self, moving: BoolArray) -> ParkingMonitor:
        """State of the monitor one scene later; `moving` as in the attributes."""
        known = self.moving is not None and self.moving.shape == moving.shape
        begun = moving & ~self.moving if known else moving  # type: ignore[operator]
        return ParkingMonitor(self.count + int(begun.sum()), bool(moving.any()), moving)

    def forgiven(self) -> ParkingMonitor:
        """The same state."""
        return self
