"""Episodes on disk as they finish, so that neither Ctrl-C nor a power cut loses one: a line of JSON each."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

import pandas as pd

from dynamics.errors import ConfigError, DataError
from evaluation.running.identity import differences, versions

__all__ = ["KEY", "SECTIONS", "Store", "commit", "provenance"]

SECTIONS = {"settings": "setting", "policies": "policy", "shields": "shield"}
"""What is asked for by name: a run that goes on may have others, and those of the same name have to be the same."""
_FREE = ("episodes", *SECTIONS)
"""What a run that goes on may have more of."""
_SHOWN = 6
"""So many differences are listed."""
KEY = ("setting", "policy", "door", "mode", "seed")
"""Columns that tell one episode from every other of a comparison."""
_AGAIN = "--force begins again, another --output keeps both"


def provenance(asked: Mapping[str, Any], earlier: Iterable[str] = ()) -> dict[str, Any]:
    """What made a file: what was asked for, the command line and those before it, the date, the versions of what took
    part, the commit of the library's source, and the machine."""
    return {
        "asked": dict(asked),
        "command": " ".join(["shield", *sys.argv[1:]]),
        "earlier": list(earlier),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "python": sys.version.split()[0],
        "versions": versions(),
        "commit": commit(),
        "machine": {"system": platform.platform(), "processor": platform.machine(), "cores": os.cpu_count()},
    }


@lru_cache(maxsize=1)
def commit() -> str:
    """The commit that the library's source is at, with "+" where files have been changed since; "" without git."""
    folder = Path(__file__).parent
    told = []
    for command in (("rev-parse", "HEAD"), ("status", "--porcelain", "--untracked-files=no")):
        try:
            done = subprocess.run(["git", *command], cwd=folder, capture_output=True, text=True, timeout=10, check=True)
        except (OSError, subprocess.SubprocessError):
            return ""
        told.append(done.stdout.strip())
    return told[0] + ("+" if told[1] else "")


class Store:
    """The episodes of one comparison that have been driven so far.

    The first line of the file says what was asked for; each of the others is an episode. A line that was cut off is as
    good as not there.

    Parameters
    ----------
    path : of the table that is to come; the episodes are beside it until then. None keeps them in memory.
    asked : what determines the rows, as plain values: mappings by name under the keys in `SECTIONS`, and whatever else
        is the same for all rows.
    resume : whether to go on where one that was stopped has left off, or to extend one that is finished.
    finished : of one that is finished, how its table was made (see `provenance`), and its rows.

    Raises
    ------
    ConfigError
        If episodes of another comparison are there: what determines their rows, or the versions of the libraries,
        differ. Or if there are some and it is not to be resumed.
    DataError
        If the file cannot be read.
    """

    def __init__(
        self,
        path: Path | None,
        asked: Mapping[str, Any],
        resume: bool = False,
        finished: tuple[Mapping[str, Any], list[dict[str, Any]]] | None = None,
    ) -> None:
        self._rows: list[dict[str, Any]] = []
        self.path: Path | None = None
        self.made = provenance(json.loads(json.dumps(asked)))
        if path is None:
            return
        self.path = path.with_name(path.name + ".episodes")
        if self.path.exists() and self.path.stat().st_size:
            if not resume:
                raise ConfigError(
                    f"{self.path.name} holds the episodes of a run that was stopped; --resume goes on with it, "
                    "--force begins again"
                )
            before, rows = self._read()
            self._go_on(self.path.name, before, rows)
        elif finished is not None:
            self._go_on(path.name, *finished)
        else:
            self._write([self.made])

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The episodes so far, as `EpisodeRecord.row` made them."""
        return list(self._rows)

    def table(self) -> pd.DataFrame:
        """The episodes so far."""
        return pd.DataFrame(self._rows)

    def done(self, setting: str, policy: str) -> set[tuple[str, str, int]]:
        """Door, mode and seed of those that need not be driven again."""
        here = [row for row in self._rows if (row["setting"], row["policy"]) == (setting, policy)]
        return {(row["door"], row["mode"], row["seed"]) for row in here}

    def add(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Write episodes, and see to it that they are on the disk."""
        # What comes back from the file and what went in are the same then.
        plain = [json.loads(json.dumps(row, default=_plain)) for row in rows]
        self._write(plain)
        self._rows += plain

    def finish(self) -> None:
        """Remove the file: the table is written."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)

    def _go_on(self, name: str, before: Mapping[str, Any], rows: Iterable[dict[str, Any]]) -> None:
        """Take the rows that are there, and add what is asked for to what was asked for."""
        asked, was = self.made["asked"], before.get("asked")
        if was is None:
            raise ConfigError(f"{name} does not say how it was made, and nothing can be added to it; {_AGAIN}")
        differ = _differences(was, asked)
        differ += differences({"version of": before.get("versions", {})}, {"version of": self.made["versions"]})
        if differ:
            more = f" and {len(differ) - _SHOWN} more" if len(differ) > _SHOWN else ""
            raise ConfigError(
                f"{name} holds episodes of another comparison: {', '.join(differ[:_SHOWN])}{more} differ; {_AGAIN}"
            )
        whole = {**asked, **{key: {**was.get(key, {}), **asked[key]} for key in SECTIONS if key in asked}}
        commands = dict.fromkeys([*before.get("earlier", ()), before.get("command", "")])
        self.made = {**self.made, "asked": whole, "earlier": list(commands)}
        seen: set[Any] = set()
        for row in rows:
            key = tuple(row[name] for name in KEY)
            if key not in seen:
                seen.add(key)
                self._rows.append(row)
        self._rewrite()

    def _rewrite(self) -> None:
        """The whole file anew, or not at all."""
        assert self.path is not None
        partial, path = self.path.with_name(self.path.name + ".partial"), self.path
        self.path = partial
        try:
            partial.unlink(missing_ok=True)
            self._write([self.made, *self._rows])
            partial.replace(path)
        finally:
            self.path = path

    def _write(self, lines: list[dict[str, Any]]) -> None:
        if self.path is None:
            return
        with self.path.open("ab") as file:
            for line in lines:
                file.write(json.dumps(line).encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())

    def _read(self) -> tuple[dict[str, Any], list[dict[str, Any]]]:
        """How the episodes that are there were made, and their rows, without one that was not written to its end."""
        assert self.path is not None
        whole, _, _torn = self.path.read_bytes().rpartition(b"\n")
        if not whole:
            # Killed before the first line was written to its end.
            return self.made, []
        try:
            first, *rows = [json.loads(line) for line in whole.split(b"\n")]
        except ValueError as error:
            raise DataError(f"{self.path} is damaged: {error}; --force begins again") from None
        return first, rows


def _differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Where what was asked for differs from what is, in words: of what has a name, where both have it."""
    found = differences(*({key: value for key, value in each.items() if key not in _FREE} for each in (before, now)))
    for key, word in SECTIONS.items():
        one, two = before.get(key, {}), now.get(key, {})
        if not (isinstance(one, Mapping) and isinstance(two, Mapping)):
            found += differences({key: one}, {key: two})
            continue
        for name in sorted(one.keys() & two.keys()):
            found += [f"{word} {name}: {each}" for each in differences(one[name], two[name])]
    return found


def _plain(value: Any) -> Any:
    """numpy's numbers as Python's."""
    return value.item()
