"""Pages of a run's worst episodes, and the commands that write them, for a report to link to."""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pandas as pd

from evaluation.policies import list_references

__all__ = ["ReplayLink", "WritesReplay", "link_replays", "worst_first"]

WritesReplay = Callable[[Path, int, str, Path], str]
"""Writes the replay of an episode, as `evaluation.replay.run_file.write_replay` does."""


@dataclass(frozen=True, slots=True)
class ReplayLink:
    """Of an episode: its `page`, relative to the report, the `command` that writes one, and a `note` where the page
    shows another episode, or none could be written; "" for what there is not."""

    page: str = ""
    command: str = ""
    note: str = ""


def worst_first(episodes: pd.DataFrame) -> pd.DataFrame:
    """Episodes with a crash, then by the smallest gap; the index keeps the numbers of the rows."""
    return episodes.sort_values(["crashed", "min_gap"], ascending=[False, True], kind="stable")


def link_replays(
    run: Path,
    episodes: pd.DataFrame,
    made: Mapping[str, Any],
    report: Path,
    count: int,
    write: WritesReplay | None,
) -> dict[int, ReplayLink]:
    """How shielded episodes of a run are replayed.

    Parameters
    ----------
    run, made : the file, and what it says of how it was made. episodes : its rows of these episodes, the worst first.
    report : the page that links to the replays. A page that `shield replay` has written since the run is
        linked as it is.
    count : of so many of the episodes a page is written where there is none. write : writes it.

    Returns
    -------
    By the numbers of the rows.
    """
    found: dict[int, ReplayLink] = {}
    for number, row in episodes.iterrows():
        key, policy = int(str(number)), _file_of(str(row["policy"]), made, run)
        page, note = run.with_name(f"{run.stem}-episode-{key}.html"), ""
        if write is not None and not _is_of(run, page) and len(found) < count:
            note = write(run, key, policy, page)
        command = ["shield", "replay", str(run), "--episode", str(key)]
        command += ["--policy", policy] if policy else []
        link = quote(os.path.relpath(page, report.parent)) if _is_of(run, page) else ""
        found[key] = ReplayLink(link, shlex.join(command), note)
    return found


def _is_of(run: Path, page: Path) -> bool:
    """Whether a page is there and not older than the run, of whose rows an older one may be no replay."""
    return page.exists() and page.stat().st_mtime >= run.stat().st_mtime


def _file_of(policy: str, made: Mapping[str, Any], run: Path) -> str:
    """The file of a policy that is a model of the user's; "" for a policy by name."""
    asked: Mapping[str, Any] = made.get("asked", {}).get("policies", {})
    if "file" not in asked.get(policy, {}) or policy in list_references():
        return ""
    beside = run.with_name(f"{policy}.zip")
    return str(beside) if beside.exists() and not Path(f"{policy}.zip").exists() else f"{policy}.zip"
