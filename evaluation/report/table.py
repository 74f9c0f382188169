"""Summaries as text tables, and tables as files.

The terminal, Markdown and LaTeX tables have the same cells.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
from rich.markup import escape
from rich.table import Table

from evaluation.measuring.columns import with_present_columns
from evaluation.names import TABLE_ENDINGS
from evaluation.running.store_rows import is_store, plain_rows, read_store
from shield.decision import Verification
from shield.errors import ConfigError

__all__ = [
    "COMPARISON",
    "SUMMARY",
    "Column",
    "cells_of",
    "finished",
    "latex",
    "made_of",
    "markdown",
    "read_episodes",
    "rich_table",
    "write_table",
]

_Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a text table: its heading, and the function from a row to its cell."""

    heading: str
    cell: Callable[[_Row], str]


def _number(value: Any, digits: int) -> str:
    return f"{float(value):.{digits}f}" if isfinite(float(value)) else "–"


def _name(row: _Row) -> str:
    return "none" if row["placement"] == "none" else f"{row['mode']} ({row['placement']})"


def _plain(heading: str, key: str, digits: int = 1) -> Column:
    return Column(heading, lambda row: _number(row[key], digits))


def _percent(heading: str, key: str) -> Column:
    return Column(heading, lambda row: _number(100 * row[key], 1))


def _interval(heading: str, key: str, factor: float = 1.0, digits: int = 1) -> Column:
    def cell(row: _Row) -> str:
        low, high = (_number(factor * row[f"{key}_{end}"], digits) for end in ("low", "high"))
        return f"{_number(factor * row[key], digits)} [{low}, {high}]"

    return Column(heading, cell)


def _reasons(row: _Row) -> str:
    """Shares of all decisions by reason, the greatest first [%]."""
    shares = {k.removeprefix("reason_"): v for k, v in row.items() if k.startswith("reason_") and v > 0}
    parts = sorted(shares.items(), key=lambda item: -item[1])
    return ", ".join(f"{name} {_number(100 * share, 1)}" for name, share in parts) or "–"


def _verification(row: _Row) -> str:
    """The verification in words; a dash if nothing is verified."""
    verification = row.get("verification") or Verification.OFF.value
    return "–" if verification == Verification.OFF else str(verification).replace("_", " ")


_NAMES = (
    Column("setting", lambda row: str(row["setting"])),
    Column("policy", lambda row: str(row["policy"])),
    Column("shield", _name),
)

SUMMARY: tuple[Column, ...] = (
    *_NAMES,
    Column("verified against", _verification),
    _plain("episodes", "episodes", 0),
    _interval("crashes %", "crash_rate", 100),
    _interval("ego's fault %", "ego_fault_rate", 100),
    _interval("off road %", "off_road_rate", 100),
    _interval("success %", "success_rate", 100),
    _interval("stopped %", "stopped_rate", 100),
    _interval("return", "return"),
    _plain("speed m/s", "mean_speed"),
    _plain("distance m", "distance", 0),
    _plain("lane changes", "lane_changes"),
    _plain("laps", "laps", 2),
    _plain("jerk m/s³", "mean_jerk", 2),
    _plain("lateral m/s²", "mean_lateral_acceleration", 2),
    _percent("overridden %", "override_rate"),
    _percent("of it held back %", "held_back_rate"),
    _percent("fallback %", "fallback_rate"),
    _plain("margin m", "min_margin", 2),
    _plain("latency p50 ms", "latency_p50_ms"),
    _plain("latency p99 ms", "latency_p99_ms"),
    Column("reasons %", _reasons),
)
"""Columns of a summary, with 95 % intervals in brackets."""

COMPARISON: tuple[Column, ...] = (
    *_NAMES,
    _plain("pairs", "pairs", 0),
    _interval("Δ crashes %", "crash_rate_difference", 100),
    _interval("Δ off road %", "off_road_rate_difference", 100),
    _interval("Δ return", "return_difference"),
    _interval("Δ speed m/s", "mean_speed_difference"),
    _plain("prevented", "crashes_prevented", 0),
    _plain("added", "crashes_added", 0),
    Column("McNemar p", lambda row: f"{row['mcnemar_p']:.2g}"),
)
"""Columns of a comparison with unshielded driving on the same seeds."""


def cells_of(frame: pd.DataFrame, columns: Sequence[Column]) -> tuple[list[str], list[list[str]]]:
    """Headings and rows of cells, without columns that have dashes only."""
    rows: list[_Row] = frame.to_dict("records")
    cells = [[column.cell(row) for column in columns] for row in rows]
    said = [any(map(str.isalnum, "".join(row[i] for row in cells))) for i in range(len(columns))]
    kept = [i for i in range(len(columns)) if i < len(_NAMES) or said[i]]
    return [columns[i].heading for i in kept], [[row[i] for i in kept] for row in cells]


def rich_table(frame: pd.DataFrame, columns: Sequence[Column] = SUMMARY) -> Table:
    """The table for a terminal: a column for each row of the frame, so that it fits 80 characters.

    A setting or policy that all rows share is in the title.
    """
    headings, cells = cells_of(frame, columns)
    names = [i for i in range(2) if len({row[i] for row in cells}) > 1]
    title = ", ".join(cells[0][i] for i in range(2) if i not in names) if cells else None
    table = Table(title=title, title_justify="left")
    table.add_column("")
    for row in cells:
        heading = "\n".join(row[i] for i in (*names, len(_NAMES) - 1))
        table.add_column(escape(heading), justify="right")
    for i in range(len(_NAMES), len(headings)):
        table.add_row(headings[i], *(escape(row[i]) for row in cells))
    return table


def markdown(frame: pd.DataFrame, columns: Sequence[Column] = SUMMARY) -> str:
    """The table in Markdown."""
    headings, cells = cells_of(frame, columns)
    aligned = ["left" if i < len(_NAMES) else "right" for i in range(len(headings))]
    table = pd.DataFrame(cells, columns=headings)
    return str(table.to_markdown(index=False, disable_numparse=True, colalign=aligned))


_LATEX = {
    **{character: f"\\{character}" for character in "&%$#_{}"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "Δ": r"$\Delta$",
    "–": "--",
    "−": "$-$",
    "²": "$^2$",
    "³": "$^3$",
}


def latex(frame: pd.DataFrame, columns: Sequence[Column] = SUMMARY) -> str:
    """The table in LaTeX, for the package booktabs."""
    headings, cells = cells_of(frame, columns)
    aligned = "".join("l" if i < len(_NAMES) else "r" for i in range(len(headings)))
    lines = [" & ".join("".join(_LATEX.get(x, x) for x in cell) for cell in row) + r" \\" for row in (headings, *cells)]
    body = [rf"\begin{{tabular}}{{{aligned}}}", r"\toprule", lines[0], r"\midrule", *lines[1:], r"\bottomrule"]
    return "\n".join([*body, r"\end{tabular}"])


def write_table(frame: pd.DataFrame, path: str | Path) -> Path:
    """Write a table as CSV or Parquet, by the ending of the file; lists in a CSV are JSON.

    `attrs["made"]` of the frame is stored in a Parquet file, and beside a CSV as NAME.json. Returns the path.

    Raises
    ------
    ConfigError
        If the file does not end in .csv or .parquet.
    """
    path = Path(path)
    _check_ending(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".parquet":
        frame.to_parquet(path, index=False)
        return path
    flat = frame.copy()
    if "latencies_ms" in flat:
        flat["latencies_ms"] = [json.dumps(list(values)) for values in flat["latencies_ms"]]
    flat.to_csv(path, index=False)
    if frame.attrs.get("made"):
        path.with_suffix(".json").write_text(json.dumps(frame.attrs["made"], indent=2) + "\n", encoding="utf-8")
    return path


def read_episodes(path: str | Path) -> pd.DataFrame:
    """Read episodes that `write_table` wrote.

    Raises
    ------
    ConfigError
        If there is no such file, it cannot be read, or it does not end in .csv or .parquet.
    """
    path = Path(path)
    _check_ending(path)
    if not path.is_file():
        raise ConfigError(f"there is no file {path}")
    try:
        return _read(path)
    except (KeyError, ValueError, pa.ArrowInvalid) as error:
        raise ConfigError(f"{path} is not a table of episodes: {error}") from None


def made_of(frame: pd.DataFrame, path: Path) -> dict[str, Any]:
    """Manifest of a table that was read from a file, see `write_table`; empty without one."""
    beside = path.with_suffix(".json")
    if path.suffix == ".csv" and beside.is_file():
        manifest: dict[str, Any] = json.loads(beside.read_text(encoding="utf-8"))
        return manifest
    return frame.attrs.get("made") or {}


def finished(path: str | Path) -> tuple[dict[str, Any], list[dict[str, Any]]] | None:
    """Read a table of episodes, or a store.

    Returns
    -------
    The manifest (see `evaluation.running.manifest.provenance`), and the rows in the form of `EpisodeRecord.row`; None
    if there is no such file.

    Raises
    ------
    ConfigError
        If the file is no such table.
    """
    path = Path(path)
    if is_store(path):
        return read_store(path)
    if not path.is_file():
        return None
    frame = read_episodes(path)
    return made_of(frame, path), plain_rows(frame)


def _read(path: Path) -> pd.DataFrame:
    if path.suffix == ".parquet":
        return with_present_columns(pd.read_parquet(path))
    frame = with_present_columns(pd.read_csv(path, keep_default_na=False, na_values=[""]))
    if "latencies_ms" in frame:
        frame["latencies_ms"] = [json.loads(text) for text in frame["latencies_ms"]]
    return frame


def _check_ending(path: Path) -> None:
    if path.suffix not in TABLE_ENDINGS:
        raise ConfigError(f"cannot tell the format of {path.name!r}; end it in .csv or .parquet")
