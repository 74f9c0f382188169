"""Variants in the report's experiments: its own rows, baselines, and this project's."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Any

from evaluation.names import check_name

__all__ = ["VARIANTS", "ReportVariant", "get_variants"]


@dataclass(frozen=True, slots=True)
class ReportVariant:
    """One row of the table.

    Attributes
    ----------
    name, label : name, and label in the table.
    action : index of a baseline's only meta-action; None for a learner.
    learner : the algorithm, as in `evaluation.learning.algorithms`; "" for a baseline, "cem" for a planner.
    model : the variant with the model that drives, if it is another variant.
    noise, confidence, intent : whether the observation has it.
    override : rule of the report that replaces actions: "preset" for the one of the preset, "distance" for that of the
        text; or "".
    skills : whether the policy chooses skills.
    report_skills : whether skills end or are gated by the report's rule; otherwise the shield's override ends them.
    shield : "", "env" for `ShieldedEnv` or "actions" for `Shield` with `frames=False`.
    observed : whether the shield reads observations only.
    penalty : override penalty in training.
    masks : whether the policy chooses among actions that verify.
    stops : whether the lowest target speed is 0.
    default_road : whether it drives in highway-env's roundabout with its default configuration.
    """

    name: str
    label: str
    action: int | None = None
    learner: str = ""
    model: str = ""
    noise: bool = False
    confidence: bool = False
    intent: bool = False
    override: str = ""
    skills: bool = False
    report_skills: bool = False
    shield: str = ""
    observed: bool = False
    penalty: float = 0.0
    masks: bool = False
    stops: bool = False
    default_road: bool = False

    @property
    def trains(self) -> bool:
        """Whether it has a model of its own."""
        return bool(self.learner) and self.learner != "cem" and not self.model

    @property
    def pooled(self) -> bool:
        """Whether its episodes are driven one at a time, and so are fewer."""
        return self.observed or self.learner == "cem"

    def as_dict(self) -> dict[str, Any]:
        """The variant as plain values."""
        plain = asdict(self)
        return plain if self.default_road else {name: x for name, x in plain.items() if name != "default_road"}


_SEEN: dict[str, Any] = {"learner": "ppo", "noise": True, "confidence": True}
_INSIDE: dict[str, Any] = {**_SEEN, "shield": "env"}
PENALTY = 0.2
"""Override penalty; the reward of a decision is at most 1."""

VARIANTS: Mapping[str, ReportVariant] = MappingProxyType(
    {
        each.name: each
        for each in (
            ReportVariant("slower", "always SLOWER", action=4),
            ReportVariant("idle", "always IDLE", action=1),
            ReportVariant("faster", "always FASTER", action=3),
            ReportVariant("stopped", "a car that stops", action=4, stops=True),
            ReportVariant("provided-baseline", "a stopped car, default configuration", action=4, default_road=True),
            ReportVariant("cem", "learned dynamics + CEM", learner="cem"),
            ReportVariant("ppo", "PPO", learner="ppo"),
            ReportVariant("noise", "noise", **_SEEN),
            ReportVariant("noise-intent", "noise + intent", **_SEEN, intent=True),
            ReportVariant("noise-distance", "noise + distance override", **_SEEN, override="distance"),
            ReportVariant("noise-override", "noise + confidence-gated override", **_SEEN, override="preset"),
            ReportVariant(
                "noise-override-skills", "noise + override + skills", **_SEEN, skills=True, report_skills=True
            ),
            ReportVariant("dqn", "DQN", learner="dqn"),
            ReportVariant("trpo", "TRPO", learner="trpo"),
            ReportVariant("shielded-env", "noise + `ShieldedEnv`", **_INSIDE, model="noise"),
            ReportVariant(
                "shield-actions", "noise + `Shield`, actions alone", **_SEEN, shield="actions", model="noise"
            ),
            ReportVariant("trained-inside", "trained inside `ShieldedEnv`", **_INSIDE),
            ReportVariant("trained-inside-penalty", "trained inside, override penalty", **_INSIDE, penalty=PENALTY),
            ReportVariant(
                "trained-inside-masks", "trained inside, masks", **{**_INSIDE, "learner": "maskableppo"}, masks=True
            ),
            ReportVariant("skills-inside", "skills inside the shield, interrupted by it", **_INSIDE, skills=True),
            ReportVariant(
                "shielded-env-observed",
                "noise + `ShieldedEnv`, observations alone",
                **_INSIDE,
                model="noise",
                observed=True,
            ),
            ReportVariant(
                "shield-observed",
                "noise + `Shield`, actions and observations alone",
                **_SEEN,
                shield="actions",
                model="noise",
                observed=True,
            ),
            ReportVariant(
                "skills-inside-observed",
                "skills inside the shield, observations alone",
                **_INSIDE,
                skills=True,
                model="skills-inside",
                observed=True,
            ),
        )
    }
)
"""Variants by name, in the order of the table."""


def get_variants(names: Iterable[str] = (), road: str = "highway") -> list[ReportVariant]:
    """Variants by name, in the order of the table, with the variants of their models.

    By default all variants of a road, "highway" or "roundabout".

    Raises
    ------
    ConfigError
        With the valid names.
    """
    requested = list(names) or [
        each.name for each in VARIANTS.values() if road == "roundabout" or not each.default_road
    ]
    for name in requested:
        check_name("variant", name, VARIANTS)
    wanted = {*requested, *(VARIANTS[name].model for name in requested)}
    return [each for each in VARIANTS.values() if each.name in wanted]
