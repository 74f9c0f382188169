"""What both doors do before they verify anything: refuse bad input, and run the rules."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import perf_counter

import numpy as np

from dynamics.scenes.scene import Scene, Target
from shield.config import ShieldConfig
from shield.decision import Decision, Reason, Tier
from shield.rules import BufferRule, RssRule, Rule, TtcRule, make_rule

__all__ = ["Fallback", "Screen", "slower"]

Fallback = Callable[[Sequence[str], int, Reason, float], Decision]
"""What acts when a proposal is refused: (action labels, proposal, reason, start time)."""


class Screen:
    """The stages in front of verification, for one configuration.

    Attributes
    ----------
    buffer : the rule that refuses a lane change into a vehicle alongside.
    """

    def __init__(self, config: ShieldConfig) -> None:
        self._off = config.mode == "none"
        self._rule: Rule | None = make_rule(config.mode, config) if config.mode in ("distance", "rss", "ttc") else None
        self.buffer = BufferRule(config.buffer.longitudinal)
        self._explain: tuple[Rule, ...] = (RssRule(config), TtcRule(config.time_to_collision))

    def decide(self, scene: Scene, proposed: int, fallback: Fallback, start: float) -> Decision | None:
        """The decision where none needs verification: no shield, bad input, or one rule alone; else None."""
        labels = scene.control.actions
        if self._off:
            return Decision(proposed, proposed, Reason.NONE, Tier.OFF, np.nan, 0.0)
        if not 0 <= proposed < len(labels):
            return fallback(labels, proposed, Reason.BAD_ACTION, start)
        if not scene.finite:
            return fallback(labels, proposed, Reason.BAD_SCENE, start)
        if self._rule is None:
            return None
        objects = self._rule.objects(scene, scene.target_of(proposed))
        executed = slower(labels) if objects else proposed
        tier = Tier.ALTERNATIVE if executed != proposed else Tier.PASSED
        reason = self._rule.reason if executed != proposed else Reason.NONE
        return Decision(proposed, executed, reason, tier, np.nan, perf_counter() - start)

    def why(self, scene: Scene, target: Target) -> Reason:
        """The reason to record for a target that did not verify."""
        return next((r.reason for r in self._explain if r.objects(scene, target)), Reason.UNVERIFIED)


def slower(labels: Sequence[str]) -> int:
    """Index of the action that slows down, or of IDLE where there is none."""
    return list(labels).index("SLOWER" if "SLOWER" in labels else "IDLE")
