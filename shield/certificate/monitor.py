"""Watches whether the traffic keeps to the assumptions: `dynamics.traffic.permits`, frame by frame."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dynamics.scenes.scene import Scene
from dynamics.state import BoolArray, FloatArray, Vehicle
from dynamics.traffic.occupancy import Surroundings
from dynamics.traffic.permits import Rule, footprint, permits
from shield.config import ShieldConfig

__all__ = ["AssumptionMonitor"]

Separations = Callable[[], FloatArray]
"""How far the ego's fail-safe stays from where each vehicle can be now, (m,) [m]; negative where it does not."""


class AssumptionMonitor:
    """Compares each scene with the one before it.

    Attributes
    ----------
    count : violations so far; a vehicle that breaks rules frame after frame counts once until it keeps to them again.
    by_rule : the same by the rule that was broken.
    offenders : who has broken a rule and may still be in the way of the ego's fail-safe, (m,) bool.
    """

    def __init__(self, config: ShieldConfig) -> None:
        self._config = config
        self._last: tuple[Surroundings, BoolArray, bool] | None = None
        self._breaking: BoolArray = np.zeros(0, dtype=bool)
        self.count = 0
        self.by_rule: dict[Rule, int] = {}
        self.offenders: BoolArray = np.zeros(0, dtype=bool)

    @property
    def violated(self) -> bool:
        """Whether anybody who has broken a rule may still be in the way."""
        return bool(self.offenders.any())

    def forgive(self) -> None:
        """A plan clears everybody again."""
        if self.offenders.any():
            self.offenders = np.zeros(self.offenders.shape, dtype=bool)

    def before(self, scene: Scene) -> Surroundings | None:
        """The surroundings of the scene before, where the others are the same."""
        if self._last is None or len(self._last[0].states) != len(scene.others):
            return None
        return self._last[0]

    def followers(self, scene: Scene) -> BoolArray | None:
        """Who owed the ego its distance in the scene before, (m,) bool; None where the others are not the same."""
        return None if self._last is None or self.before(scene) is None else self._last[1]

    def update(
        self,
        scene: Scene,
        around: Surroundings,
        behind: BoolArray,
        held: BoolArray,
        period: float,
        fail_safe: Separations,
    ) -> None:
        """Take in the next scene.

        Parameters
        ----------
        scene, around : the scene, and its surroundings, which know those of the scene before.
        behind, held : who is behind the ego with its buffer, and who is in a lane that it owns, (m,) bool.
        period : time since the scene before [s].
        fail_safe : asked where somebody has taken more room than before.
        """
        before, last = self.before(scene), self._last
        self._last = around, behind & held, bool(scene.ego[Vehicle.CRASHED] > 0)
        if before is None or last is None:
            self.offenders = np.zeros(len(scene.others), dtype=bool)
            self._breaking = self.offenders
            return
        b = self._config.buffer
        crashed = bool(scene.ego[Vehicle.CRASHED] > 0) and not last[2]
        seen = footprint(scene.ego, b.longitudinal, b.lateral, crashed)
        broken, grown = permits(before, around, period, last[1], seen)
        # Who comes beside the ego in its own lane has not stayed behind.
        grown |= np.where(last[1] & held & ~behind, int(Rule.DISTANCE), 0)
        if grown.any():
            # Who takes more room than before has to leave it to the ego's fail-safe.
            broken |= np.where(fail_safe() < 0, grown, 0)
        breaking = broken != 0
        if not breaking.any():
            self._breaking = breaking
            return
        for i in np.flatnonzero(breaking & ~self._breaking):
            self.count += 1
            rules = Rule(int(broken[i]))
            self.by_rule = {**self.by_rule, **{rule: self.by_rule.get(rule, 0) + 1 for rule in rules}}
        self._breaking = breaking
        self.offenders = self.offenders | breaking
