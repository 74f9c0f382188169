"""Drives the experiments of `benchmarks/results.toml`, and writes their tables and commands into docs/lab/results.md.

    python benchmarks/results.py                       # all of them, kept in runs/results; goes on where it was stopped
    python benchmarks/results.py --only "Planners"     # one table
    python benchmarks/results.py --episodes 5 --out runs/try --page ""   # a trial, that is printed alone

One revision drives all: a table of another one in --out is refused. The short table of docs/results.md has rows of
these, and is written with them (`short_tables.py`).
"""

from __future__ import annotations

import argparse
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from short_tables import write_all

from evaluation import Experiment, Result
from evaluation.report.table import SUMMARY, markdown
from evaluation.running.manifest import commit
from shield.errors import ConfigError

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "lab" / "results.md"
FIRST, LAST = "<!-- tables: python benchmarks/results.py -->", "<!-- end of the tables -->"
SHOWN = (
    *("setting", "policy", "shield", "verified against", "episodes", "crashes %", "off road %", "success %", "return"),
    *("speed m/s", "jerk m/s³", "overridden %", "fallback %", "latency p50 ms", "latency p99 ms"),
)
_NOTE = "note"
"""Of a run: what its shielded rows are called besides."""
OPTIONS = {"env": "setting"}
"""Options of `shield evaluate` that are called otherwise than the attributes of `Experiment`."""


def command(run: Mapping[str, Any]) -> str:
    """The command of an experiment."""
    words = ["shield", "evaluate"]
    for name, value in run.items():
        if name == _NOTE:
            continue
        words += [f"--{OPTIONS.get(name, name)}", ",".join(value) if isinstance(value, list) else str(value)]
    return " ".join(words)


def narrow(text: str) -> str:
    """A Markdown table without the spaces that align it."""
    return re.sub(r"-{3,}", "--", re.sub(r" {2,}", " ", text))


def table(each: Mapping[str, Any], folder: Path, episodes: int | None, jobs: int) -> str:
    """The part of the page about one table, whose episodes are driven where they are not in the folder."""
    found: list[pd.DataFrame] = []
    slug = re.sub(r"\W+", "-", each["title"].lower())
    for number, run in enumerate(each["run"]):
        path = folder / f"{slug}-{number}.parquet"
        options = {key: value for key, value in run.items() if key != _NOTE}
        if episodes is not None:
            options["episodes"] = episodes
        if path.exists():
            result = Result.read(path)
            if result.made.get("commit") != commit():
                raise ConfigError(f"{path} was made by revision {result.made.get('commit')}, not by {commit()}")
        else:
            partial = path.with_name(f"{path.name}.episodes").exists()
            result = Experiment(**options, jobs=jobs, output=path, resume=partial).run()
        summary = result.summary
        if _NOTE in run:
            summary["mode"] += f", {run[_NOTE]}"
        found.append(summary)
    frame = pd.concat(found, ignore_index=True)
    columns = [column for column in SUMMARY if column.heading in SHOWN]
    commands = "\n".join(command(run) for run in each["run"])
    return f"## {each['title']}\n\n{each['text']}\n\n```\n{commands}\n```\n\n{narrow(markdown(frame, columns))}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs", "results"))
    parser.add_argument("--only", help="one title")
    parser.add_argument("--episodes", type=int, help="of each row, in place of those of the file")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--page", default=str(PAGE), help='"" prints only')
    asked = parser.parse_args()
    tables = tomllib.loads((ROOT / "benchmarks" / "results.toml").read_text(encoding="utf-8"))["table"]
    parts = []
    for each in tables:
        if asked.only in (None, each["title"]):
            parts.append(table(each, asked.out, asked.episodes, asked.jobs))
            print(parts[-1], flush=True)
    if asked.page and asked.only is None and asked.episodes is None:
        page = Path(asked.page)
        before, _, left = page.read_text(encoding="utf-8").partition(FIRST)
        _, mark, after = left.partition(LAST)
        if not mark:
            raise ConfigError(f"{page.name} has no place for the tables: {FIRST} and {LAST}")
        body = "\n\n".join([FIRST, f"Revision {commit()[:7]}.", *parts, LAST])
        page.write_text(before + body + after, encoding="utf-8")
        if page == PAGE:
            write_all()


if __name__ == "__main__":
    main()
