"""Report of runs as one offline HTML page: tables, charts, and the worst episodes."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from importlib.resources import files
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jinja2 import Environment, StrictUndefined

from evaluation.measuring.metrics import GROUP, compare, latencies_of, summarise
from evaluation.report.charts import Mark, crosses, ranges
from evaluation.report.replay_links import ReplayLink, WritesReplay, link_replays, worst_first
from evaluation.report.table import COMPARISON, SUMMARY, Column, cells_of, finished
from shield.errors import ConfigError

__all__ = ["write_report"]

_GLANCE = ("episodes", "crashes %", "off road %", "return", "speed m/s", "overridden %", "latency p99 ms")
"""Columns of the first table."""
_WORST, _WORST_BARE = 9, 3
"""Number of listed episodes of each run, with the shield and without."""
_TIMES = (0.5, 0.01, 0.99)
_TIME_LEFT = "least time to collision [s]: 1 %, median, 99 %"


def write_report(
    runs: Sequence[str | Path],
    output: str | Path,
    replays: int = 0,
    write: WritesReplay | None = None,
) -> Path:
    """Write the page of some runs.

    Parameters
    ----------
    runs : files of episodes, .parquet or .csv. The file names distinguish the rows of several runs.
    output : path of the .html file.
    replays : number of the worst shielded episodes of each run with a linked replay.
    write : function that writes a replay.

    Returns
    -------
    The path of the page.

    Raises
    ------
    ConfigError
        If there are no runs, one cannot be read, or two have the same name.
    """
    output = Path(output)
    if output.suffix != ".html":
        raise ConfigError(f"a report is an .html file, not {output.name!r}")
    if not runs:
        raise ConfigError("a report needs at least one run")
    read = {}
    for path in map(Path, runs):
        found = finished(path)
        if found is None:
            raise ConfigError(f"there is no file {path}")
        if path.stem in read:
            raise ConfigError(f"two runs are called {path.stem!r}; rename one of the files")
        read[path.stem] = (found[0], pd.DataFrame(found[1]), path)
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    source = files("evaluation.report").joinpath("report.html.jinja").read_text(encoding="utf-8")
    page = environment.from_string(source).render(
        title=" and ".join(read),
        runs=[
            _run(name, made, frame, path, link_replays(path, _shielded(frame, replays), made, output, replays, write))
            for name, (made, frame, path) in read.items()
        ],
        charts=_charts({name: frame for name, (_, frame, _) in read.items()}),
    )
    output.parent.mkdir(parents=True, exist_ok=True)
    output.write_text(page, encoding="utf-8")
    return output


def _run(
    name: str, made: Mapping[str, Any], episodes: pd.DataFrame, path: Path, links: Mapping[int, ReplayLink]
) -> dict[str, Any]:
    """Values of the page's template for one run."""
    summary, comparison = summarise(episodes), compare(episodes)
    glance = [column for column in SUMMARY[:3] if column.heading != "setting"]
    glance += [column for heading in _GLANCE for column in SUMMARY if column.heading == heading]
    return {
        "name": name,
        "made": {
            key: made[key] for key in ("command", "date", "commit", "python", "machine", "versions") if key in made
        },
        "settings": [
            {"name": setting, "glance": _table(part, glance), "full": _table(part, SUMMARY)}
            for setting, part in summary.groupby("setting", sort=False)
        ],
        "comparison": _table(comparison, COMPARISON) if len(comparison) else None,
        "worst": _worst(episodes, links),
        "file": path.name,
    }


def _table(frame: pd.DataFrame, columns: Sequence[Column]) -> dict[str, Any]:
    """Headings and rows of cells."""
    headings, rows = cells_of(frame, columns)
    return {
        "headings": headings,
        "rows": rows,
        "shielded": [placement != "none" for placement in frame["placement"]],
    }


def _shielded(episodes: pd.DataFrame, count: int = 0) -> pd.DataFrame:
    """The worst shielded episodes: those of the list, and at least `count`."""
    return worst_first(episodes[episodes["placement"] != "none"]).head(max(_WORST, count))


def _worst(episodes: pd.DataFrame, links: Mapping[int, ReplayLink]) -> list[dict[str, Any]]:
    """The worst episodes, crashes first and then by least gap; shielded ones before the others."""
    found = []
    bare = worst_first(episodes[episodes["placement"] == "none"]).head(_WORST_BARE)
    for number, row in pd.concat([_shielded(episodes), bare]).iterrows():
        link = links.get(int(str(number)), ReplayLink())
        found.append(
            {
                "name": ", ".join(str(row[key]) for key in GROUP),
                "seed": row["seed"],
                "crashed": bool(row["crashed"]),
                "cause": row["attribution"],
                "gap": f"{row['min_gap']:.2f}",
                "return": f"{row['return']:.1f}",
                "overridden": row["overridden"],
                "page": link.page,
                "note": link.note,
                "command": link.command,
            }
        )
    return found


def _charts(runs: Mapping[str, pd.DataFrame]) -> list[dict[str, str]]:
    """The charts of each setting, over all runs."""
    several, found, nothing = len(runs) > 1, [], pd.Series(dtype=float)
    together = pd.concat([frame.assign(run=name) for name, frame in runs.items()], ignore_index=True)
    for setting, part in together.groupby("setting", sort=False):
        marks, gaps, times, margins, costs = [], [], [], [], []
        for kind, (key, group) in enumerate(part.groupby(["run", "policy", "placement", "mode"], sort=False)):
            run, policy, placement, mode = key
            label = f"{policy}, {'no shield' if placement == 'none' else f'{mode} ({placement})'}" + (
                f", {run}" * several
            )
            row = summarise(group).iloc[0]
            crash = tuple(100 * float(row[f"crash_rate{end}"]) for end in ("", "_low", "_high"))
            returns = tuple(float(row[f"return{end}"]) for end in ("", "_low", "_high"))
            marks.append(Mark(label, kind, crash, returns))  # type: ignore[arg-type]
            gaps.append(Mark(label, kind, tuple(np.quantile(group["min_gap"], _TIMES).tolist())))
            if placement != "none" and group.get("min_time_to_collision", nothing).notna().any():
                times_left = tuple(np.nanquantile(group["min_time_to_collision"].astype(float), _TIMES).tolist())
                costs.append(Mark(label, kind, (100 * float(row["override_rate"]), nan, nan), times_left))
            if group["min_margin"].notna().any():
                margins.append(Mark(label, kind, tuple(np.nanquantile(group["min_margin"], _TIMES).tolist())))
            latencies = latencies_of(group)
            if latencies.size:
                times.append(Mark(label, kind, tuple(np.quantile(latencies, _TIMES).tolist())))
        found.append(
            {
                "setting": str(setting),
                "labels": json.dumps([mark.label for mark in marks]),
                "risk": crosses(marks, "crashed [% of episodes]", "return"),
                "gaps": ranges(gaps, "smallest gap of an episode [m]: 1 %, median, 99 %"),
                "overrides": crosses(costs, "decisions overridden [%]", _TIME_LEFT) if costs else "",
                "margins": ranges(margins, "smallest margin of an episode [m]: 1 %, median, 99 %") if margins else "",
                "latencies": ranges(times, "latency of a decision [ms]: 1 %, median, 99 %") if times else "",
            }
        )
    return found
