"""Reports of the shield's decisions in a step and in an episode."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from shield.decision import Decision, Guarantee, Intervention, weakest
from shield.explanation import Explanation

__all__ = ["Statistics", "ViolationCount", "multi_agent_record", "multi_agent_report", "report"]


class ViolationCount:
    """Number of violations of a filter at one time, for the difference to a later one."""

    def __init__(self, action_filter: Any) -> None:
        self._violations: int = action_filter.violations
        self._by_rule: dict[str, int] = action_filter.by_rule

    def since(self, action_filter: Any) -> tuple[int, dict[str, int]]:
        """Number of violations since then, and by rule."""
        rules = {rule: count - self._by_rule.get(rule, 0) for rule, count in action_filter.by_rule.items()}
        return action_filter.violations - self._violations, {rule: count for rule, count in rules.items() if count}


@dataclass(slots=True)
class Statistics:
    """Totals of a shield's decisions so far.

    Attributes
    ----------
    decisions, overridden : number of decisions, and of those in which the action or a frame was replaced.
    held_back : the decisions among `overridden` that kept the proposed action, and replaced only frames.
    frames_overridden, violations : number of replaced frames, and of violations by the traffic.
    rules : violations of each rule; several rules violated by a vehicle at once are one violation in `violations`.
    reasons : number of decisions with each reason.
    margin : least known margin of an executed plan [m]; NaN without one.
    latency : total time of the decisions [s].
    guarantee : the weakest of all steps. The summary has `Guarantee.BROKEN` after a violation.
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
        """Add one report, and the time of the decision and its frames [s]."""
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
        """Add violations by the traffic that no report contains."""
        self.violations += violations
        self.rules.update(rules)

    def summary(self) -> dict[str, Any]:
        """Content of `info["shield_episode"]`: the counts, the margin, the mean latency of a decision [ms], and the
        weakest guarantee. The guarantee is no better than `Guarantee.BROKEN` after a violation."""
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
    """Content of `info["shield"]` for the record of a step (`Decision.with_frames`).

    Parameters
    ----------
    violations, rules : number of violations of the assumptions by the traffic, in total and by rule.
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
class _FirstRefusal:
    """Explains the record of several egos by its first refused proposal."""

    decision: Decision

    def explain(self, at: Decision, record: Decision, frame: int) -> Explanation:
        """See `shield.decision.Source`."""
        return self.decision.explain()


def multi_agent_record(decisions: Sequence[Decision]) -> Decision:
    """The decisions about several egos as one record, with tuples of the proposed and of the executed actions."""
    together = decisions[0].with_frames(decisions[1:])
    proposed, executed = (tuple(getattr(each, name) for each in decisions) for name in ("proposed", "executed"))
    first = None if together.refusal is None else together.refusal[0]
    return replace(
        together,
        proposed=proposed,
        executed=executed,
        frames=0,
        frames_overridden=0,
        first_overridden=None,
        refusal=None if first is None else (replace(first, source=_FirstRefusal(first)), 0),
    )


def multi_agent_report(
    record: Decision, decisions: Sequence[Decision], violations: int, rules: Mapping[str, int]
) -> dict[str, Any]:
    """The record of several egos, see `multi_agent_record`, and the report of each decision under `agents`."""
    return {**report(record, violations, rules), "agents": [report(each, 0, {}) for each in decisions]}
