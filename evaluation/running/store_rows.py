"""Rows of a store as read from its folder, and the JSON line of an open row."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from dynamics.errors import ConfigError, DataError
from evaluation.measuring.columns import with_present_keys
from evaluation.running.parts import MANIFEST, PARTS, Parts

__all__ = ["KEY", "OPEN", "is_store", "line_of", "lines_of", "once", "plain_rows", "read_lines", "read_store"]

KEY = ("setting", "policy", "placement", "mode", "seed")
"""Columns that identify an episode within a comparison."""
OPEN = "open.jsonl"
"""Name of the file of open rows, which are in no part yet."""


def is_store(path: str | Path) -> bool:
    """Whether a folder is a store."""
    return (Path(path) / MANIFEST).is_file() and (Path(path) / PARTS).is_dir()


def read_store(folder: str | Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Read a store.

    Returns
    -------
    The manifest, and the rows: those of the parts, by name, then the open rows. Duplicates of an episode are dropped.

    Raises
    ------
    ConfigError
        If the folder is no store.
    DataError
        If a file cannot be read.
    """
    parts = Parts(folder)
    made = parts.manifest
    if made is None:
        raise ConfigError(f"{folder} is no store of episodes: it has no {MANIFEST}")
    rows = [row for name in parts.names for row in plain_rows(parts.read(name))]
    path = parts.folder / OPEN
    if path.is_file():
        rows += read_lines(path)
    return made, once(rows)


def plain_rows(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of a table in the form of `EpisodeRecord.row`, with None or "" instead of NaN for unknown values."""
    empty = {"violations": None, "success": None, "rules": ""}
    rows = []
    for row in frame.to_dict("records"):
        if "latencies_ms" in row:
            row["latencies_ms"] = [float(each) for each in row["latencies_ms"]]
        blank = {key: nothing for key, nothing in empty.items() if key in row and pd.isna(row[key])}
        rows.append({**{str(key): value for key, value in row.items()}, **blank})
    return rows


def once(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows without duplicates of an episode; rows of experiments other than comparisons are unchanged."""
    found: dict[Any, dict[str, Any]] = {}
    for number, row in enumerate(rows):
        found.setdefault(tuple(row[name] for name in KEY) if row.keys() >= set(KEY) else number, row)
    return list(found.values())


def read_lines(path: Path) -> list[dict[str, Any]]:
    """Parse each line of JSON; an incomplete last line is dropped."""
    whole, _, _torn = path.read_bytes().rpartition(b"\n")
    try:
        return [with_present_keys(json.loads(line)) for line in whole.split(b"\n")] if whole else []
    except ValueError as error:
        raise DataError(f"{path} is damaged: {error}; --force begins again") from None


def line_of(row: Mapping[str, Any]) -> bytes:
    """A row as a line of JSON."""
    return json.dumps(row, default=_plain_number).encode() + b"\n"


def lines_of(rows: Iterable[Mapping[str, Any]]) -> bytes:
    """A line of JSON for each row."""
    return b"".join(line_of(row) for row in rows)


def _plain_number(value: Any) -> Any:
    """A numpy number as a Python number."""
    return value.item()
