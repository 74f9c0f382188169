"""What a step reports of the shield."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from shield.decision import Decision, Guarantee, Intervention, weakest
from shield.explanation import Explanation

__all__ = ["Offences", "Statistics", "report", "team_record", "team_report"]


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
    held_back : how many of `overridden` kept the proposed action, and had frames replaced only.
    frames_overridden, violations : frames that were replaced, and offences of the traffic.
    rules : how often each rule was broken; who breaks several at once is one offence.
    reasons : how often each was the reason.
    margin : the smallest that is known of what was executed [m]; NaN where there is none.
    latency : all the time that it took [s].
    guarantee : the weakest of all steps. The summary has `Guarantee.BROKEN` where there were offences.
    """

    decisions: int = 0
    overridden: int = 0
    held_back: int = 0
    frames_overridden: int = 0
    violations: int = 0
    rules: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    margin: float = float("nan")
    latency: float = 0.0
    guarantee: Guarantee = Guarantee.ALL_SEEN

    def add(self, report: Mapping[str, Any], latency: float) -> None:
        """Count one report, and the time that the decision and its frames took [s]."""
        self.decisions += 1
        self.overridden += report["overridden"]
        self.held_back += report["intervention"] == Intervention.HELD_BACK
        self.frames_overridden += report["frames_overridden"]
        self.violations += report["violations"]
        self.rules.update(report["rules"])
        self.reasons[report["reason"]] += 1
        self.margin = float(np.fmin(self.margin, report["margin"]))
        self.latency += latency
        self.guarantee = weakest(self.guarantee, Guarantee(report["guarantee"]))

    def add_offences(self, violations: int, rules: Mapping[str, int]) -> None:
        """Count offences of the traffic that no report has."""
        self.violations += violations
        self.rules.update(rules)

    def summary(self) -> dict[str, Any]:
        """As `info["shield_episode"]` has it: the counts, the margin, the mean latency of a decision [ms], and the
        weakest guarantee: no better than `Guarantee.BROKEN` where the traffic has broken an assumption."""
        return {
            "decisions": self.decisions,
            "overridden": self.overridden,
            "held_back": self.held_back,
            "frames_overridden": self.frames_overridden,
            "violations": self.violations,
            "rules": dict(self.rules),
            "margin": self.margin,
            "latency_ms": 1e3 * self.latency / max(self.decisions, 1),
            "reasons": dict(self.reasons),
            "guarantee": weakest(self.guarantee, Guarantee.BROKEN if self.violations else Guarantee.ALL_SEEN).value,
        }


def report(record: Decision, violations: int, rules: Mapping[str, int]) -> dict[str, Any]:
    """The record of a step (`Decision.with_frames`) as `info["shield"]` has it.

    Parameters
    ----------
    violations, rules : of the assumptions, by the traffic; and how often each rule was broken.
    """
    return {
        "overridden": record.overridden,
        "intervention": record.intervention.value,
        "reason": record.reason.value,
        "tier": record.tier.value,
        "margin": record.margin,
        "frames_overridden": record.frames_overridden,
        "violations": violations,
        "rules": dict(rules),
        "guarantee": record.guarantee.value,
    }


@dataclass(frozen=True, slots=True)
class _OfOne:
    """Explains the record of several egos by the first of them whose proposal was refused."""

    decision: Decision

    def explain(self, at: Decision, record: Decision, frame: int) -> Explanation:
        """See `shield.decision.Source`."""
        return self.decision.explain()


def team_record(decisions: Sequence[Decision]) -> Decision:
    """The decisions about several egos as one record, with a tuple of their proposals and one of what was executed."""
    together = decisions[0].with_frames(decisions[1:])
    proposed, executed = (tuple(getattr(each, name) for each in decisions) for name in ("proposed", "executed"))
    first = None if together.refusal is None else together.refusal[0]
    return replace(
        together,
        proposed=proposed,
        executed=executed,
        frames=0,
        frames_overridden=0,
        held=None,
        refusal=None if first is None else (replace(first, source=_OfOne(first)), 0),
    )


def team_report(
    record: Decision, decisions: Sequence[Decision], violations: int, rules: Mapping[str, int]
) -> dict[str, Any]:
    """The record of several egos, see `team_record`, and each decision by itself under `agents`."""
    return {**report(record, violations, rules), "agents": [report(each, 0, {}) for each in decisions]}
