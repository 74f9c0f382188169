"""Episodes on disk as they finish, so that neither Ctrl-C nor a power cut loses one: a line of JSON each."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from dynamics.errors import ConfigError, DataError

__all__ = ["Store", "provenance"]

_PACKAGES = ("highway-shield", "highway-env", "gymnasium", "stable-baselines3", "torch", "numpy", "numba")
_KEY = ("setting", "policy", "door", "mode", "seed")


def provenance(asked: Mapping[str, Any]) -> dict[str, Any]:
    """What made a file: what was asked for, the command line, the date, and the versions of what took part."""
    versions = {}
    for name in _PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    command = " ".join(["shield", *sys.argv[1:]])
    python = sys.version.split()[0]
    return {
        "asked": dict(asked),
        "command": command,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "python": python,
        "versions": versions,
    }


class Store:
    """The episodes of one comparison that have been driven so far.

    The first line of the file says what was asked for; each of the others is an episode. A line that was cut off is as
    good as not there.

    Parameters
    ----------
    path : of the table that is to come; the episodes are beside it until then. None keeps them in memory.
    asked : what tells one comparison from another.
    resume : whether to go on where one that was stopped has left off.

    Raises
    ------
    ConfigError
        If episodes of another comparison are there, or there are some and it is not to be resumed.
    """

    def __init__(self, path: Path | None, asked: Mapping[str, Any], resume: bool = False) -> None:
        self._rows: list[dict[str, Any]] = []
        self.path: Path | None = None
        if path is None:
            return
        self.path = path.with_name(path.name + ".episodes")
        asked = json.loads(json.dumps(asked))
        if self.path.exists() and self.path.stat().st_size:
            if not resume:
                raise ConfigError(
                    f"{self.path.name} holds the episodes of a run that was stopped; --resume goes on with it, "
                    "--force begins again"
                )
            self._read(asked)
        else:
            self._write([provenance(asked)])

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The episodes so far, as `EpisodeRecord.row` made them."""
        return list(self._rows)

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

    def _write(self, lines: list[dict[str, Any]]) -> None:
        if self.path is None:
            return
        with self.path.open("ab") as file:
            for line in lines:
                file.write(json.dumps(line).encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())

    def _read(self, asked: Any) -> None:
        assert self.path is not None
        whole, _, torn = self.path.read_bytes().rpartition(b"\n")
        lines = whole.split(b"\n") if whole else []
        try:
            first, *rows = [json.loads(line) for line in lines] or [{}]
        except ValueError as error:
            raise DataError(f"{self.path} is damaged: {error}; --force begins again") from None
        before = first.get("asked")
        if before != asked and lines:
            keys = sorted(k for k in {*asked, *(before or {})} if (before or {}).get(k) != asked.get(k))
            raise ConfigError(
                f"{self.path.name} holds episodes of another comparison: {', '.join(keys)} differ; --force begins again"
            )
        if torn or not lines:
            # Cut off what has not been written to its end, so that the next line begins at the start of one.
            with self.path.open("r+b") as file:
                file.truncate(len(whole) + 1 if lines else 0)
            if not lines:
                self._write([provenance(asked)])
        seen: set[Any] = set()
        for row in rows:
            key = tuple(row[name] for name in _KEY)
            if key not in seen:
                seen.add(key)
                self._rows.append(row)


def _plain(value: Any) -> Any:
    """numpy's numbers as Python's."""
    return value.item()
