"""Storage of episodes on disk as they finish. A killed process loses none; a power cut loses those of the last second.

A store is a folder. `manifest.json` holds the origin of the rows. `parts/NAME.parquet` holds episodes, and each part is
written atomically. `open.jsonl` holds the episodes since the last part, one line of JSON each. `shield evaluate`,
`shield certify` and `shield reproduce` write a store; the final table of `shield evaluate --output` contains the
manifest.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from dynamics.errors import ConfigError
from evaluation.running.manifest import check_fits, extended, provenance
from evaluation.running.parts import MANIFEST, Parts, replace_file
from evaluation.running.store_rows import OPEN, line_of, lines_of, once, read_lines, read_store

__all__ = ["Store", "discard"]

_AGAIN = "--force begins again, another --output keeps both"
_PART = 1_000
"""Number of open episodes, one line each, after which a part is written."""
_SYNC = 1.0
"""Least time between two calls of `fsync` [s]; one takes milliseconds, as long as a compiled episode. Data between two
calls is in the operating system's cache, which outlives the process."""


class Store:
    """The episodes of a comparison driven so far.

    Parameters
    ----------
    path : path of the final table; until then the episodes are in the folder PATH.episodes. None keeps them in memory.
    specification : values that determine the rows, as plain values: mappings by name under the keys in
        `evaluation.running.manifest.SECTIONS`, and values that all rows share.
    resume : whether to continue a stopped run, or to extend a finished one.
    finished : manifest and rows of a finished run.
    models : see `provenance`.

    Raises
    ------
    ConfigError
        If the folder holds episodes of another comparison: the values that determine the rows, or the versions of the
        libraries, differ. Also if it holds episodes and `resume` is false.
    DataError
        If the episodes cannot be read.

    Attributes
    ----------
    made : the manifest.
    parts : the folder of the episodes; None in memory.
    """

    def __init__(
        self,
        path: Path | None,
        specification: Mapping[str, Any],
        resume: bool = False,
        finished: tuple[Mapping[str, Any], list[dict[str, Any]]] | None = None,
        models: Mapping[str, str] | None = None,
    ) -> None:
        self._rows: list[dict[str, Any]] = []
        self._open = 0
        self._synced = -_SYNC
        self.parts: Parts | None = None
        self.made = provenance(json.loads(json.dumps(specification)), models=models)
        if path is None:
            return
        folder = _folder(path)
        _adopt(folder)
        self.parts = Parts(folder)
        if self.parts.manifest is not None:
            if not resume:
                raise ConfigError(
                    f"{folder.name} holds the episodes of a run that was stopped; --resume goes on with it, "
                    "--force begins again"
                )
            self._go_on(folder.name, *read_store(folder))
        elif finished is not None:
            self._go_on(path.name, *finished)
        else:
            # Without a manifest the origin of files in the folder is unknown.
            discard(path)
            self.parts.claim(self.made)

    @classmethod
    def in_folder(
        cls,
        folder: Path,
        specification: Mapping[str, Any],
        models: Mapping[str, str] | None = None,
        instead: str = _AGAIN,
    ) -> Store:
        """A store that remains a folder; an existing one is continued.

        Parameters
        ----------
        folder : the folder.
        specification, models : as in the class.
        instead : advice for the message, if the folder holds something else.

        Raises
        ------
        ConfigError
            If the folder holds episodes of another comparison, or of unknown origin, or cannot be written.
        """
        store = cls(None, specification, models=models)
        store.parts = Parts(folder)
        if store.parts.manifest is not None:
            store._go_on(str(folder), *read_store(folder), instead)
        elif store.parts.names or (folder / OPEN).exists():
            raise ConfigError(f"{folder} holds episodes without a {MANIFEST} that says how they were made; {instead}")
        else:
            store.parts.claim(store.made)
        return store

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The episodes so far, as rows of `EpisodeRecord.row`."""
        return list(self._rows)

    def table(self) -> pd.DataFrame:
        """The episodes so far, as a table."""
        return pd.DataFrame(self._rows)

    def add(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Append episodes to the file, which outlives this process; call `fsync` at most once a second."""
        # Rows are read back from JSON, so that they equal those of a later read.
        lines = [line_of(row) for row in rows]
        self._rows += [json.loads(line) for line in lines]
        if self.parts is None:
            return
        with (self.parts.folder / OPEN).open("ab") as file:
            file.write(b"".join(lines))
            file.flush()
            if time.monotonic() - self._synced >= _SYNC:
                os.fsync(file.fileno())
                self._synced = time.monotonic()
        self._open += len(lines)
        if self._open >= _PART:
            self._close()

    def note(self, entries: Mapping[str, Any]) -> None:
        """Add values to the manifest that do not determine the rows."""
        self.made = {**self.made, **entries}
        if self.parts is not None:
            self.parts.claim(self.made)

    def finish(self) -> None:
        """Remove the folder, once the table is written."""
        if self.parts is not None:
            shutil.rmtree(self.parts.folder, ignore_errors=True)

    def _go_on(
        self, name: str, before: Mapping[str, Any], rows: Iterable[dict[str, Any]], instead: str = _AGAIN
    ) -> None:
        """Take over the existing rows, and merge both specifications."""
        assert self.parts is not None
        check_fits(name, before, self.made, instead)
        self.made = extended(before, self.made)
        self._rows = once(rows)
        kept = sum(len(self.parts.read(each)) for each in self.parts.names)
        # The last open row may be incomplete.
        self._open = len(self._rows) - kept
        self._rewrite(self._rows[kept:])
        self.parts.claim(self.made)

    def _close(self) -> None:
        """Write the open episodes as a part.

        A process killed between the two writes leaves them in both files; `once` drops the duplicates.
        """
        assert self.parts is not None
        self.parts.write(f"{len(self.parts.names):06d}", pd.DataFrame(self._rows[-self._open :]))
        self._rewrite([])
        self._open = 0

    def _rewrite(self, rows: list[dict[str, Any]]) -> None:
        """Replace the file of open rows."""
        assert self.parts is not None
        self.parts.folder.mkdir(parents=True, exist_ok=True)
        replace_file(self.parts.folder / OPEN, lines_of(rows))


def discard(path: Path) -> None:
    """Remove the stored episodes of a table, for a new start."""
    folder = _folder(path)
    for each in (folder, _partial(folder)):
        if each.is_dir():
            shutil.rmtree(each)
        else:
            each.unlink(missing_ok=True)


def _folder(path: Path) -> Path:
    return path.with_name(path.name + ".episodes")


def _partial(folder: Path) -> Path:
    return folder.with_name(folder.name + ".partial")


def _adopt(folder: Path) -> None:
    """Convert the file of earlier versions to a folder: its first line is the manifest, every other line an episode."""
    partial = _partial(folder)
    if not folder.exists() and partial.is_dir():
        partial.rename(folder)
    if not folder.is_file():
        return
    lines = read_lines(folder)
    if partial.exists():
        shutil.rmtree(partial)
    if lines:
        Parts(partial).claim(lines[0])
        replace_file(partial / OPEN, lines_of(lines[1:]))
    folder.unlink()
    if lines:
        partial.rename(folder)
