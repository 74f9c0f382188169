"""A table with a row for each decision, beside the table of episodes."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from evaluation.measuring.columns import present_columns, with_present_columns
from evaluation.running.store_rows import KEY
from shield.errors import ConfigError

__all__ = ["DECISIONS", "check_steps", "is_steps", "keep_steps", "merge_steps", "steps_of", "write_steps"]

DECISIONS = "decisions"
"""Column of an episode's row that holds its decisions, until they are written."""


def steps_of(rows: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """The decisions of episodes, one row each, by episode and then in time.

    Parameters
    ----------
    rows : rows of episodes that were driven with `steps`.

    Returns
    -------
    The columns `KEY` of the episode, and then:

    - `step`, and `time`, its start [s];
    - `reward`;
    - `proposed` and `executed`, lists of numbers, and the three distances of
      `evaluation.running.records.EpisodeRecord`;
    - from the shield's report `overridden`, `intervention`, `reason`, `tier`, `margin` [m], `frames_overridden`,
      `violations`, and `latency_ms`;
    - `confidence`, the mean of the observed rows;
    - at the decision's end `speed` [m/s], `acceleration` [m/s^2] and `steering` [rad], inferred from the ego's motion
    in
      the last frame, `on_lane` and `crashed`.
    """
    parts = []
    for row in rows:
        part = pd.DataFrame(json.loads(row[DECISIONS]))
        for place, name in enumerate(KEY):
            part.insert(place, name, row[name])
        parts.append(part)
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=list(KEY))


def check_steps(path: Path, earlier: Iterable[Mapping[str, Any]]) -> None:
    """Check that all earlier episodes have decisions, in their rows or in the file.

    Raises
    ------
    ConfigError
        With the number of episodes without decisions.
    """
    lacking = {_key(row) for row in earlier if not isinstance(row.get(DECISIONS), str)}
    if lacking and path.is_file():
        lacking -= {tuple(each) for each in _read(path)[list(KEY)].drop_duplicates().itertuples(index=False, name=None)}
    if lacking:
        raise ConfigError(
            f"{len(lacking)} episodes that are there already have no decisions in {path}; give the --steps file of the "
            "earlier run, or begin again with --force"
        )


def write_steps(path: Path, episodes: pd.DataFrame) -> pd.DataFrame:
    """Write the decisions of episodes to a Parquet file, after those of other episodes in it.

    Parameters
    ----------
    path : path of the file.
    episodes : episodes with the column `DECISIONS`.

    Returns
    -------
    The episodes without that column.
    """
    has = episodes[DECISIONS].map(lambda each: isinstance(each, str))
    frame, requested = steps_of(episodes[has].to_dict("records")), {_key(row) for row in episodes.to_dict("records")}
    if path.is_file() and not has.all():
        before = _read(path)
        keys = pd.Series(list(before[list(KEY)].itertuples(index=False, name=None)), before.index)
        new = {_key(row) for row in episodes[has].to_dict("records")}
        frame = pd.concat([before[keys.isin(requested - new)], frame], ignore_index=True)
    keep_steps(path, frame)
    return episodes.drop(columns=DECISIONS)


def keep_steps(path: Path, steps: pd.DataFrame) -> None:
    """Write a table of decisions to a Parquet file, atomically; its folder is created."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    steps.to_parquet(partial, index=False)
    partial.replace(path)


def is_steps(path: Path) -> bool:
    """Whether a file is a table of decisions."""
    if path.suffix != ".parquet" or not path.is_file():
        return False
    try:
        return {*KEY, "step", "proposed"} <= present_columns(pq.read_schema(path).names)
    except pa.ArrowInvalid:
        return False


def merge_steps(paths: Iterable[Path], episodes: pd.DataFrame) -> pd.DataFrame:
    """Merge the decisions of all episodes of an experiment from the files of its shards.

    Parameters
    ----------
    paths : paths of the files.
    episodes : episodes of the whole experiment (see `evaluation.experiments.result.merge`).

    Returns
    -------
    A table as from `steps_of`, in the order of `episodes`.

    Raises
    ------
    ConfigError
        If a file is no table of decisions, or the decisions are not exactly those of the episodes.
    """
    frame = pd.concat([_read(path) for path in paths], ignore_index=True)
    names = list(KEY)
    if frame.duplicated([*names, "step"]).any():
        raise ConfigError("a decision is in two of the --steps files")
    place = {_key(row): k for k, row in enumerate(episodes.to_dict("records"))}
    keys = [place.get(key, -1) for key in frame[names].itertuples(index=False, name=None)]
    counts = pd.Series(keys, dtype=int).value_counts()
    if -1 in counts.index:
        raise ConfigError(f"the --steps files have {counts[-1]} decisions of episodes that are in no part")
    lacking = [key for key, k in place.items() if counts.get(k, 0) != episodes["steps"].iloc[k]]
    if lacking:
        raise ConfigError(
            f"decisions of {len(lacking)} of {len(episodes)} episodes are missing, the first is "
            f"{', '.join(map(str, lacking[0]))}; give the --steps file of each part"
        )
    frame["place"] = keys
    return frame.sort_values(["place", "step"], ignore_index=True).drop(columns="place")


def _read(path: Path) -> pd.DataFrame:
    try:
        if not set(KEY) <= present_columns(pq.read_schema(path).names):
            raise ConfigError(f"{path} has other columns than a table of decisions")
        return with_present_columns(pd.read_parquet(path))
    except pa.ArrowInvalid as error:
        raise ConfigError(f"{path} is no table of decisions: {error}") from None


def _key(row: Mapping[str, Any]) -> tuple[Any, ...]:
    return tuple(row[name] for name in KEY)
