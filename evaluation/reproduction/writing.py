"""Files of an experiment: episodes, table and verdict."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd

from evaluation.report.table import write_table
from evaluation.reproduction.running import Reproduction, first_seed
from evaluation.reproduction.table import summary, table
from evaluation.reproduction.verdict import judge, verdicts_text
from evaluation.running.manifest import commit

__all__ = ["write"]


def write(episodes: pd.DataFrame, experiment: Reproduction, folder: Path) -> str:
    """Write episodes.parquet and .csv, summary.json, table.md and verdict.json, and return the text of table.md."""
    for ending in ("parquet", "csv"):
        write_table(episodes, folder / f"episodes.{ending}")
    found, verdicts = summary(episodes), judge(episodes)
    found.to_json(folder / "summary.json", orient="records", indent=2)
    judged = {"preset": experiment.preset.name, "claims": [each.plain() for each in verdicts]}
    (folder / "verdict.json").write_text(json.dumps(judged, indent=2) + "\n", encoding="utf-8")
    left_out = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))["left out"]
    preset = experiment.preset
    of_each = f"{experiment.episodes:,} episodes each ({experiment.pooled:,} of rows that take long)"
    lines = [
        f"# The report's {preset.road}, {preset.name}: {preset.description}",
        f"{experiment.seeds} training seeds of {experiment.steps:,} steps, {of_each}, seeds from "
        f"{first_seed(preset):,}, revision {commit()[:12] or 'unknown'}. Crash rates with Wilson 95 % intervals; "
        "over seeds, and returns: bootstrap over training seeds and episodes. *Rule*: steps that the report's rule "
        "replaced; *shield*: that the shield overrode. Confidence: the mean of the last column of the ego's row "
        "(published).",
        table(found),
        *(f"`{name}` is left out: {reason}." for name, reason in left_out.items()),
        "## Claims",
        verdicts_text(verdicts),
    ]
    text = "\n\n".join(lines) + "\n"
    (folder / "table.md").write_text(text, encoding="utf-8")
    return text
