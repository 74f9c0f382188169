"""What a step reports of the shield."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from shield.decision import Decision, Guarantee

__all__ = ["Offences", "Statistics", "report", "team_report"]

_WEAKER = list(Guarantee)
"""From the strongest to none."""


class Offences:
    """How often the traffic had broken the assumptions when something began, as a door counts it."""

    def __init__(self, door: Any) -> None:
        self._violations: int = door.violations
        self._by_rule: dict[str, int] = door.by_rule

    def since(self, door: Any) -> tuple[int, dict[str, int]]:
        """How often it has since then, and how often each rule was broken."""
        rules = {rule: count - self._by_rule.get(rule, 0) for rule, count in door.by_rule.items()}
        return door.violations - self._violations, {rule: count for rule, count in rules.items() if count}


@dataclass(slots=True)
class Statistics:
    """What a shield has done so far.

    Attributes
    ----------
    decisions, overridden : how many there were, and of how many the action or a frame was replaced.
    frames_overridden, violations : frames that were replaced, and offences of the traffic.
    rules : how often each rule was broken; who breaks several at once is one offence.
    reasons : how often each was the reason.
    margin : the smallest that is known of what was executed [m]; NaN where there is none.
    latency : all the time that it took [s].
    """

    decisions: int = 0
    overridden: int = 0
    frames_overridden: int = 0
    violations: int = 0
    rules: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    margin: float = float("nan")
    latency: float = 0.0

    def add(self, report: Mapping[str, Any], latency: float) -> None:
        """Count one report, and the time that the decision and its frames took [s]."""
        self.decisions += 1
        self.overridden += report["overridden"]
        self.frames_overridden += report["frames_overridden"]
        self.violations += report["violations"]
        self.rules.update(report["rules"])
        self.reasons[report["reason"]] += 1
        self.margin = float(np.fmin(self.margin, report["margin"]))
        self.latency += latency

    def summary(self) -> dict[str, Any]:
        """As `info["shield_episode"]` has it: the counts, the margin, and the mean latency of a decision [ms]."""
        return {
            "decisions": self.decisions,
            "overridden": self.overridden,
            "frames_overridden": self.frames_overridden,
            "violations": self.violations,
            "rules": dict(self.rules),
            "margin": self.margin,
            "latency_ms": 1e3 * self.latency / max(self.decisions, 1),
            "reasons": dict(self.reasons),
        }


def report(decision: Decision, frames: Sequence[Decision], violations: int, rules: Mapping[str, int]) -> dict[str, Any]:
    """A decision and those about its frames as one: overridden where one of them is, with the reason of a fallback
    before that of any other, and the weakest guarantee of them all.

    Parameters
    ----------
    violations, rules : of the assumptions, by the traffic; and how often each rule was broken.
    """
    held = [d for d in frames if d.overridden]
    overridden = [decision, *held] if decision.overridden else held
    shown = next((d for d in overridden if d.tier.fallback), overridden[0] if overridden else decision)
    margins = [d.margin for d in (decision, *frames) if np.isfinite(d.margin)]
    return {
        "overridden": bool(overridden),
        "reason": shown.reason.value,
        "tier": shown.tier.value,
        "margin": min(margins, default=float("nan")),
        "frames_overridden": len(held),
        "violations": violations,
        "rules": dict(rules),
        "guarantee": max((d.guarantee for d in (decision, *frames)), key=_WEAKER.index).value,
    }


def team_report(decisions: Sequence[Decision], violations: int, rules: Mapping[str, int]) -> dict[str, Any]:
    """The decisions about several egos as one, and each by itself under `agents`."""
    together = report(decisions[0], decisions[1:], violations, rules)
    return {**together, "frames_overridden": 0, "agents": [report(each, (), 0, {}) for each in decisions]}
