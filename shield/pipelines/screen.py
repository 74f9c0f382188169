"""Checks of a meta-action before its verification: validity, and the rules."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from dynamics.scenes.scene import Scene, Target
from shield.alternatives.preference import Order, resolve
from shield.certificate.road.memory import Memory
from shield.config import ShieldConfig
from shield.decision import Reason, Tier
from shield.pipelines.decide import JudgedPlan, Plan, Unreadable
from shield.rules import BufferRule, RssRule, Rule, TtcRule, make_rule

__all__ = ["MetaActionProposal", "RulePipeline", "RuleScreen", "slower"]


@dataclass(frozen=True, slots=True)
class MetaActionProposal:
    """A proposed meta-action.

    Attributes
    ----------
    action : its index; -1 for an invalid one. labels : of the available actions, by index.
    order : the alternatives in the policy's order of preference, or a function that returns it; None without one.
    """

    action: int
    labels: Sequence[str]
    order: Order = None


class RuleScreen:
    """The stages before verification, for one configuration.

    Attributes
    ----------
    buffer : the rule that refuses a lane change into a vehicle alongside.
    """

    def __init__(self, config: ShieldConfig) -> None:
        self.buffer = BufferRule(config.buffer.longitudinal)
        self._explain: tuple[Rule, ...] = (RssRule(config), TtcRule(config.time_to_collision))

    def refuses(self, scene: Scene, proposal: MetaActionProposal) -> Reason | None:
        """Reason if the proposal is invalid or the scene is not finite; else None."""
        if not 0 <= proposal.action < len(proposal.labels):
            return Reason.BAD_ACTION
        return None if scene.finite else Reason.BAD_SCENE

    def why(self, scene: Scene, target: Target) -> Reason:
        """The reason to record for a target command that did not verify."""
        return next((r.reason for r in self._explain if r.objects(scene, target)), Reason.UNVERIFIED)


class RulePipeline:
    """One rule without verification. It replaces a refused action by SLOWER, or in the mode "ttc-ranking" by the first
    accepted action in the policy's order of preference.

    Parameters
    ----------
    config : its `mode` names the rule.
    rule : a user's own rule in its place.

    Attributes
    ----------
    rule : the rule that decides.
    """

    def __init__(self, config: ShieldConfig, rule: Rule | None = None) -> None:
        self.config = config
        self._screen, self.rule = RuleScreen(config), rule if rule is not None else make_rule(config.mode, config)

    def refuses(self, scene: Scene, proposal: MetaActionProposal) -> Reason | None:
        """Reason if the proposal is invalid or the scene is not finite; else None."""
        return self._screen.refuses(scene, proposal)

    def observe(self, memory: Memory[Any], scene: Scene) -> tuple[Scene, Memory[Any]]:
        """The scene itself, with the memory unchanged."""
        return scene, memory

    def plans(self, view: Scene, proposal: MetaActionProposal) -> Iterator[JudgedPlan[Any]]:
        """The proposal, or the action that replaces it."""
        executed = next((a for a in self._candidates(proposal) if not self._refuses(view, a)), slower(proposal.labels))
        passed = executed == proposal.action
        tier, reason = (Tier.PASSED, Reason.NONE) if passed else (Tier.ALTERNATIVE, self.rule.reason)
        yield JudgedPlan(tier, reason, Plan(executed, trusted=True))

    def _candidates(self, proposal: MetaActionProposal) -> Iterator[int]:
        """The proposal and, in the mode "ttc-ranking", the policy's other actions in order of preference."""
        yield proposal.action
        if self.config.mode == "ttc-ranking":
            yield from (a for a in resolve(proposal.order) or () if 0 <= a < len(proposal.labels))

    def _refuses(self, view: Scene, action: int) -> bool:
        return self.rule.objects(view, view.target_of(action))

    def fall_back(self, view: Scene, proposal: MetaActionProposal, tried: list[JudgedPlan[Any]]) -> JudgedPlan[Any]:
        """Never called: `plans` always has a trusted plan."""
        return tried[-1]

    def last_resort(
        self, memory: Memory[Any], scene: Scene | Unreadable, proposal: MetaActionProposal
    ) -> tuple[Tier, Plan[Any]]:
        """SLOWER."""
        return Tier.EMERGENCY, Plan(slower(proposal.labels))


def slower(labels: Sequence[str]) -> int:
    """Index of SLOWER, or of IDLE where there is no SLOWER."""
    return list(labels).index("SLOWER" if "SLOWER" in labels else "IDLE")
