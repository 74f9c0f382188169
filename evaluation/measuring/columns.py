"""Former names of columns in tables of episodes, which files of earlier versions have."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import pandas as pd

__all__ = ["FORMER_COLUMNS", "present_columns", "with_present_columns", "with_present_keys"]

FORMER_COLUMNS = {"door": "placement"}
"""Present names of columns, by the former name."""


def present_columns(names: Iterable[str]) -> set[str]:
    """The present names of columns.

    Examples
    --------
    >>> sorted(present_columns(["door", "seed"]))
    ['placement', 'seed']
    """
    return {FORMER_COLUMNS.get(name, name) for name in names}


def with_present_columns(frame: pd.DataFrame) -> pd.DataFrame:
    """A table with the present names of its columns; the table itself if it has no former name."""
    return frame.rename(columns=FORMER_COLUMNS) if FORMER_COLUMNS.keys() & set(frame.columns) else frame


def with_present_keys(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row with the present names of its columns."""
    return {FORMER_COLUMNS.get(name, name): value for name, value in row.items()}
