"""`reproduce`: the report's tables from Python, like `shield reproduce highway` and `roundabout`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from evaluation.reproduction.presets import get_preset
from evaluation.reproduction.running import Reproduction, run
from evaluation.reproduction.table import summary
from evaluation.reproduction.variants import get_variants
from evaluation.reproduction.verdict import Verdict, judge
from evaluation.reproduction.writing import write

__all__ = ["QUICK", "ReproductionResult", "reproduce"]

QUICK = {"seeds": 2, "episodes": 60, "pooled": 3, "steps": 2_048}
"""Counts of a run of about a minute."""


@dataclass(frozen=True)
class ReproductionResult:
    """Result of the report's experiments.

    Attributes
    ----------
    episodes : a row for each episode.
    summary : a row for each variant, with intervals.
    claims : the report's claims, each with its verdict.
    text : the table and the claims in Markdown.
    folder : folder of the results and the models.
    """

    episodes: pd.DataFrame
    summary: pd.DataFrame
    claims: Sequence[Verdict]
    text: str
    folder: Path

    def __str__(self) -> str:
        """The table and the claims in Markdown."""
        return self.text


def reproduce(
    preset: str = "as-coded",
    variants: Sequence[str] = (),
    out: str | Path | None = None,
    jobs: int = 1,
    tell: Callable[[str], None] | None = None,
    road: str = "highway",
    **counts: int,
) -> ReproductionResult:
    """Train and drive the report's and this project's variants, beside the published numbers.

    Finished parts in `out` are reused.

    Parameters
    ----------
    preset : "as-coded" or "as-written".
    variants : variants of the table; all by default.
    out : a folder, runs/reproduce/ROAD-PRESET by default.
    jobs : processes, one training seed each.
    tell : called with a line after each part.
    road : "highway" or "roundabout".
    counts : values of `seeds`, `episodes`, `pooled` and `steps` that replace the defaults of `Reproduction`; `**QUICK`
        for a table in about a minute.

    Raises
    ------
    ConfigError
        If there is no such preset or variant, or a count is not valid.
    """
    chosen = get_preset(preset, road)
    chosen_parts = Reproduction(chosen, tuple(get_variants(list(variants), road)), **{"steps": chosen.steps, **counts})
    folder = Path("runs", "reproduce", f"{road}-{preset}") if out is None else Path(out)
    episodes = run(chosen_parts, folder, jobs, tell)
    return ReproductionResult(
        episodes, summary(episodes), judge(episodes), write(episodes, chosen_parts, folder), folder
    )
