"""Watches whether the others keep to the assumptions, frame by frame.

Traffic has to keep to `dynamics.traffic.permits`; in a parking lot everything has to stand still.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dynamics.compiled import uncounted
from dynamics.scenes.scene import Scene
from dynamics.state import BoolArray, FloatArray, Vehicle
from dynamics.traffic.occupancy import Surroundings
from dynamics.traffic.permits import Ego, Rule, permits

__all__ = ["Stillness", "Watch", "stayed"]


_DISTANCE = int(Rule.DISTANCE)


def _nobody() -> BoolArray:
    return np.zeros(0, dtype=bool)


Separations = Callable[[], FloatArray]
"""How far the ego's fail-safe stays from where each vehicle can be now, (m,) [m]; negative where it does not."""


@uncounted
def stayed(owed: Any, behind: Any, held: Any, broken: Any, grown: Any, owing: Any) -> tuple[bool, bool]:
    """Fill in who owes the ego its distance now, `owing`, and add to `grown` who has not stayed behind: who owed it,
    and has come beside it in its own lane. Returns whether anybody has broken a rule, and taken more room."""
    some, more = False, False
    for i in range(owed.shape[0]):
        owing[i] = behind[i] and held[i]
        if owed[i] and held[i] and not behind[i]:
            grown[i] |= _DISTANCE
        some, more = some or broken[i] != 0, more or grown[i] != 0
    return some, more


@dataclass(frozen=True, slots=True, eq=False)
class Watch:
    """What has been seen of the others up to one scene.

    Attributes
    ----------
    around : their surroundings in that scene; None before the first.
    owing : who of them owed the ego its distance, (m,) bool.
    crashed : whether the ego had crashed.
    breaking : who was breaking a rule in that very frame, (m,) bool.
    offenders : who has broken a rule and may still be in the way of the ego's fail-safe, (m,) bool.
    count : violations so far; a vehicle that breaks rules frame after frame counts once until it keeps to them again.
    by_rule : the same by the rule that was broken.
    """

    around: Surroundings | None = None
    owing: BoolArray = field(default_factory=_nobody)
    crashed: bool = False
    breaking: BoolArray = field(default_factory=_nobody)
    offenders: BoolArray = field(default_factory=_nobody)
    count: int = 0
    by_rule: Mapping[Rule, int] = field(default_factory=dict)

    @property
    def violated(self) -> bool:
        """Whether anybody who has broken a rule may still be in the way."""
        return bool(self.offenders.any())

    @property
    def named(self) -> dict[str, int]:
        """`by_rule` by the names of the rules."""
        return {str(rule): count for rule, count in self.by_rule.items()}

    def forgiven(self) -> Watch:
        """The same once a plan clears everybody again."""
        return replace(self, offenders=np.zeros(self.offenders.shape, dtype=bool)) if self.violated else self

    def before(self, scene: Scene) -> Surroundings | None:
        """The surroundings that were seen last, where the others are the same as in `scene`, and their states exact."""
        if self.around is None or scene.ids is not None or len(self.around.states) != len(scene.others):
            return None
        return self.around

    def followers(self, scene: Scene) -> BoolArray | None:
        """Who owed the ego its distance in the scene seen last, (m,) bool; None where the others are not the same."""
        return None if self.before(scene) is None else self.owing

    def next(
        self,
        scene: Scene,
        ego: Ego,
        around: Surroundings,
        behind: BoolArray,
        held: BoolArray,
        period: float,
        fail_safe: Separations,
    ) -> Watch:
        """The watch one scene later.

        Parameters
        ----------
        scene, ego : the scene, and the ego with its buffer in it.
        around : its surroundings, which know those of the scene before.
        behind, held : who is behind the ego with its buffer, and who is in a lane that it owns, (m,) bool.
        period : time since the scene before [s].
        fail_safe : asked where somebody has taken more room than before.
        """
        before = self.before(scene)
        crashed = bool(scene.ego[Vehicle.CRASHED] > 0)
        if before is None:
            nobody = np.zeros(len(scene.others), dtype=bool)
            return Watch(around, behind & held, crashed, nobody, nobody, self.count, self.by_rule)
        if crashed and not self.crashed:
            ego = ego._replace(crashed=True)
        broken, grown = permits(before, around, period, self.owing, ego)
        owing = np.empty(len(broken), dtype=bool)
        some, more = stayed(self.owing, behind, held, broken, grown, owing)
        if more:
            # Who takes more room than before has to leave it to the ego's fail-safe.
            broken |= np.where(fail_safe() < 0, grown, 0)
            some = bool(broken.any())
        breaking = broken != 0
        if not some:
            return Watch(around, owing, crashed, breaking, self.offenders, self.count, self.by_rule)
        count, by_rule = self.count, dict(self.by_rule)
        for i in np.flatnonzero(breaking & ~self.breaking):
            count += 1
            for rule in Rule(int(broken[i])):
                by_rule[rule] = by_rule.get(rule, 0) + 1
        return Watch(around, owing, crashed, breaking, self.offenders | breaking, count, by_rule)


@dataclass(frozen=True, slots=True, eq=False)
class Stillness:
    """What has been seen of a lot where everything is assumed to stand; a `Watch` that forgives nothing.

    Attributes
    ----------
    count : how often something has begun to move. violated : whether something moves now.
    moving : which obstacles did in the lot seen last, (m,) bool; they are matched by their order.
    """

    count: int = 0
    violated: bool = False
    moving: BoolArray | None = None

    @property
    def named(self) -> dict[str, int]:
        """As of `Watch`."""
        return {"moving": self.count} if self.count else {}

    def next(self, moving: BoolArray) -> Stillness:
        """The same one lot later."""
        known = self.moving is not None and self.moving.shape == moving.shape
        begun = moving & ~self.moving if known else moving  # type: ignore[operator]
        return Stillness(self.count + int(begun.sum()), bool(moving.any()), moving)

    def forgiven(self) -> Stillness:
        """The same."""
        return self
