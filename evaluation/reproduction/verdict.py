"""Verdicts: whether each claim of the report holds at these counts, and whether this project's figures are reached."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd

from evaluation.measuring.statistics import Interval, clopper_pearson, nested_bootstrap
from evaluation.reproduction.presets import PUBLISHED, PublishedFigures, published_for
from evaluation.reproduction.table import summary
from evaluation.reproduction.variants import VARIANTS

__all__ = ["Verdict", "judge", "verdicts_text"]


@dataclass(frozen=True, slots=True)
class Verdict:
    """Verdict on one claim.

    Attributes
    ----------
    name : name of the claim.
    kind : "report" for a claim of the report; "compatible" for the claim that its 10 episodes agree with the rate
        measured here; "figure" for a figure of this project.
    holds : whether the claim holds.
    sentence : the claim and the numbers.
    """

    name: str
    kind: str
    holds: bool
    sentence: str

    def plain(self) -> dict[str, Any]:
        """The verdict as plain values."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class _Comparison:
    name: str
    claim: str
    column: str
    more: str
    less: str


_COMPARISONS = (
    _Comparison("noise-crashes", "noise makes PPO crash more", "crashed", "noise", "ppo"),
    _Comparison("intent-crashes", "intent makes it crash less under noise", "crashed", "noise", "noise-intent"),
    _Comparison("intent-return", "intent raises its return under noise", "return", "noise-intent", "noise"),
    _Comparison("override-crashes", "the override makes it crash more", "crashed", "noise-override", "noise"),
    _Comparison("skills-crashes", "override and skills crash less", "crashed", "noise", "noise-override-skills"),
    _Comparison("skills-return", "override and skills return more", "return", "noise-override-skills", "noise"),
    _Comparison(
        "skills-slower-crashes",
        "override and skills crash less than always SLOWER",
        "crashed",
        "slower",
        "noise-override-skills",
    ),
    _Comparison(
        "skills-slower-return",
        "override and skills return more than always SLOWER",
        "return",
        "noise-override-skills",
        "slower",
    ),
    _Comparison(
        "skills-stopped-return",
        "override and skills return more than a car that stops",
        "return",
        "noise-override-skills",
        "stopped",
    ),
)
_SHIELDED = ("shielded-env", "trained-inside", "trained-inside-penalty", "trained-inside-masks", "skills-inside")
_INSIDE = ("skills-inside", "skills-inside-observed")


def judge(episodes: pd.DataFrame) -> list[Verdict]:
    """Verdicts on all claims about the variants in a table of episodes.

    A claim that one variant has more than another holds if the 95 % interval of the difference is above 0. The interval
    is over training seeds and episodes of the same scenes.
    """
    found = {row["variant"]: row for row in summary(episodes).to_dict("records")}
    published = published_for(str(episodes["preset"].iloc[0]))
    without_crash = [name for name, figures in published.items() if figures.crash_rate == 0.0]
    return [
        *_compared(episodes, found),
        *_without_crash(found, without_crash),
        *_compatible(found, published),
        *_figures(episodes, found),
    ]


def verdicts_text(verdicts: list[Verdict]) -> str:
    """The verdicts as a list in Markdown."""
    return "\n".join(f"- **{'Holds' if each.holds else 'Does not hold'}**: {each.sentence}" for each in verdicts)


def _difference(episodes: pd.DataFrame, column: str, more: str, less: str) -> Interval:
    """Difference of the means of two variants in the same scenes."""
    keys = ["training_seed", "seed"]
    one, two = (episodes[episodes["variant"] == each].set_index(keys)[column].astype(float) for each in (more, less))
    both = (one - two).dropna()
    return nested_bootstrap([each.to_numpy() for _, each in both.groupby(level="training_seed")])


def _compared(episodes: pd.DataFrame, found: dict[str, dict[str, Any]]) -> Iterator[Verdict]:
    for each in _COMPARISONS:
        if each.more not in found or each.less not in found:
            continue
        apart = _difference(episodes, each.column, each.more, each.less)
        rate = each.column == "crashed"
        key, unit, factor = ("crash_rate", " %", 100.0) if rate else ("return", "", 1.0)
        means = [f"{factor * found[name][key]:.{1 if rate else 2}f}{unit}" for name in (each.more, each.less)]
        ends = f"{factor * apart.estimate:.2f} [{factor * apart.low:.2f}, {factor * apart.high:.2f}]"
        labels = [VARIANTS[name].label for name in (each.more, each.less)]
        sentence = (
            f"{each.claim}: {'crash rate' if rate else 'return'} {means[0]} of {labels[0]!r} and {means[1]} of "
            f"{labels[1]!r}, a difference of {ends}{' points' if rate else ''}."
        )
        yield Verdict(each.name, "report", apart.low > 0.0, sentence)


def _without_crash(found: dict[str, dict[str, Any]], names: Iterable[str]) -> Iterator[Verdict]:
    for name in names:
        if name in found:
            crashes = round(found[name]["crash_rate"] * found[name]["episodes"])
            label, n = VARIANTS[name].label, found[name]["episodes"]
            yield Verdict(f"{name}-0", "report", crashes == 0, f"{label!r} does not crash: {crashes:,} of {n:,} do.")


def _compatible(found: dict[str, dict[str, Any]], published: Mapping[str, PublishedFigures]) -> Iterator[Verdict]:
    for name, figures in published.items():
        if name not in found:
            continue
        count, rate = round(figures.crash_rate * figures.episodes), found[name]["crash_rate"]
        drawn = clopper_pearson(count, figures.episodes)
        sentence = (
            f"the published {count} crashes in {figures.episodes} episodes of {VARIANTS[name].label!r} "
            f"(95 % [{100 * drawn.low:.0f}, {100 * drawn.high:.0f}] %) go with {100 * rate:.1f} % of "
            f"{found[name]['episodes']:,} here."
        )
        yield Verdict(f"{name}-published", "compatible", drawn.low <= rate <= drawn.high, sentence)


def _figures(episodes: pd.DataFrame, found: dict[str, dict[str, Any]]) -> Iterator[Verdict]:
    if episodes["preset"].iloc[0] == "as-coded":
        yield from _as_coded(found)
    for name in _SHIELDED:
        if name in found:
            row = found[name]
            sentence = f"{VARIANTS[name].label!r} has no crash: {100 * row['crash_rate']:.2f} % of {row['episodes']:,} "
            sentence += f"(at most {100 * row['crash_rate_high']:.3f} %), return {row['return']:.2f}."
            yield Verdict(f"{name}-crashes", "figure", row["crash_rate"] == 0.0, sentence)
    for name in _INSIDE if episodes["preset"].iloc[0] == "as-coded" else ():
        if name in found and "slower" in found:
            row, apart = found[name], _difference(episodes, "return", name, "slower")
            good = row["crash_rate"] <= 0.003 and row["return"] >= 21.6 and apart.low > 0.0
            sentence = (
                f"{VARIANTS[name].label!r}: crashes at most 0.3 %, return at least 21.6 and above always SLOWER's; "
                f"{100 * row['crash_rate']:.2f} %, {row['return']:.2f}, and {apart.estimate:.2f} "
                f"[{apart.low:.2f}, {apart.high:.2f}] more."
            )
            yield Verdict(f"{name}-figure", "figure", good, sentence)


def _as_coded(found: dict[str, dict[str, Any]]) -> Iterator[Verdict]:
    for name, low, high in (("noise-override", 0.88, 0.96), ("noise-override-skills", 0.0, 0.09)):
        if name in found:
            rate = found[name]["crash_rate"]
            sentence = f"the crash rate of {VARIANTS[name].label!r} is from {low} to {high}: {rate:.3f}."
            yield Verdict(f"{name}-range", "figure", low <= rate <= high, sentence)
    if "noise" in found:
        figures, confidence = PUBLISHED["noise"].confidence, found["noise"]["confidence"]
        assert figures is not None
        sentence = f"the confidence of 'noise' is within 0.01 of the published {figures}: {confidence:.4f}."
        yield Verdict("noise-confidence", "figure", bool(np.abs(confidence - figures) <= 0.01), sentence)
