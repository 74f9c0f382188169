"""Replay pages of a run's worst episodes, and commands that write them, for links in a report."""

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
"""Function that writes the replay of an episode, such as `evaluation.replay.run_file.write_replay`."""


@dataclass(frozen=True, slots=True)
class ReplayLink:
    """Replay of an episode; values that do not exist are "".

    Attributes
    ----------
    page : page of the replay, relative to the report.
    command : command that writes one.
    note : remark if the page shows another episode, or none could be written.
    """

    page: str = ""
    command: str = ""
    note: str = ""


def worst_first(episodes: pd.DataFrame) -> pd.DataFrame:
    """Episodes with a crash, then by least gap; the index keeps the row numbers."""
    return episodes.sort_values(["crashed", "min_gap"], ascending=[False, True], kind="stable")


def link_replays(
    run: Path,
    episodes: pd.DataFrame,
    made: Mapping[str, Any],
    report: Path,
    count: int,
    write: WritesReplay | None,
) -> dict[int, ReplayLink]:
    """Links to the replays of shielded episodes of a run.

    Parameters
    ----------
    run, made : file of the run, and its manifest.
    episodes : rows of the episodes in the run, the worst first.
    report : path of the report. A page that `shield replay` has written since the run is linked unchanged.
    count : number of episodes for which a missing page is written.
    write : function that writes a page.

    Returns
    -------
    The links by row number.
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
    """Whether a page exists and is not older than the run; an older one may show another episode."""
    return page.exists() and page.stat().st_mtime >= run.stat().st_mtime


def _file_of(policy: str, made: Mapping[str, Any], run: Path) -> str:
    """File of a policy that is a model of the user; "" for a policy by name."""
    policies_asked: Mapping[str, Any] = made.get("asked", {}).get("policies", {})
    if "file" not in policies_asked.get(policy, {}) or policy in list_references():
        return ""
    beside = run.with_name(f"{policy}.zip")
    return str(beside) if beside.exists() and not Path(f"{policy}.zip").exists() else f"{policy}.zip"
