"""Episodes on disk as they finish: neither Ctrl-C nor `kill -9` loses one, and a power cut those of the last second.

A store is a folder: `manifest.json` says what made the rows, `parts/NAME.parquet` has episodes, each part written whole
or not at all, and `open.jsonl` those since the last part, a line of JSON each. `shield evaluate`, `shield certify` and
`shield reproduce` write it; the table that `shield evaluate --output` writes at its end has the manifest in it.
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
"""Episodes that are kept a line each before they become a part."""
_SYNC = 1.0
"""At least so much time lies between two waits for the disk [s]; one takes milliseconds, as long as a compiled episode.
Until then the operating system has what was written, which outlives the process."""


class Store:
    """The episodes of one comparison that have been driven so far.

    Parameters
    ----------
    path : of the table that is to come; the episodes are in the folder PATH.episodes until then. None keeps them in
        memory.
    asked : what determines the rows, as plain values: mappings by name under the keys in
        `evaluation.running.manifest.SECTIONS`, and whatever else is the same for all rows.
    resume : whether to go on where one that was stopped has left off, or to extend one that is finished.
    finished : of one that is finished, its manifest, and its rows.
    models : see `provenance`.

    Raises
    ------
    ConfigError
        If episodes of another comparison are there: what determines their rows, or the versions of the libraries,
        differ. Or if there are some and it is not to be resumed.
    DataError
        If they cannot be read.

    Attributes
    ----------
    made : the manifest. parts : where the episodes are; None in memory.
    """

    def __init__(
        self,
        path: Path | None,
        asked: Mapping[str, Any],
        resume: bool = False,
        finished: tuple[Mapping[str, Any], list[dict[str, Any]]] | None = None,
        models: Mapping[str, str] | None = None,
    ) -> None:
        self._rows: list[dict[str, Any]] = []
        self._open = 0
        self._synced = -_SYNC
        self.parts: Parts | None = None
        self.made = provenance(json.loads(json.dumps(asked)), models=models)
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
            # Without a manifest nothing that lies there is known.
            discard(path)
            self.parts.claim(self.made)

    @classmethod
    def in_folder(
        cls, folder: Path, asked: Mapping[str, Any], models: Mapping[str, str] | None = None, instead: str = _AGAIN
    ) -> Store:
        """A store that stays a folder, gone on with where it is one already.

        Parameters
        ----------
        asked, models : as of the class. instead : what can be done where something else is there, for a message.

        Raises
        ------
        ConfigError
            If episodes of another comparison are there, or some of which nothing is known, or it cannot be written.
        """
        store = cls(None, asked, models=models)
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
        """The episodes so far, as `EpisodeRecord.row` made them."""
        return list(self._rows)

    def table(self) -> pd.DataFrame:
        """The episodes so far."""
        return pd.DataFrame(self._rows)

    def add(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Write episodes to the file, where they outlive this process; at most once a second, wait for the disk."""
        # What comes back from the file and what went in are the same then.
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

    def note(self, told: Mapping[str, Any]) -> None:
        """Add to the manifest what does not determine the rows."""
        self.made = {**self.made, **told}
        if self.parts is not None:
            self.parts.claim(self.made)

    def finish(self) -> None:
        """Remove the folder: the table is written."""
        if self.parts is not None:
            shutil.rmtree(self.parts.folder, ignore_errors=True)

    def _go_on(
        self, name: str, before: Mapping[str, Any], rows: Iterable[dict[str, Any]], instead: str = _AGAIN
    ) -> None:
        """Take the rows that are there, and add what is asked for to what was asked for."""
        assert self.parts is not None
        check_fits(name, before, self.made, instead)
        self.made = extended(before, self.made)
        self._rows = once(rows)
        kept = sum(len(self.parts.read(each)) for each in self.parts.names)
        # Of the rows that are in no part, the last may have been cut off.
        self._open = len(self._rows) - kept
        self._rewrite(self._rows[kept:])
        self.parts.claim(self.made)

    def _close(self) -> None:
        """Make a part of the episodes that are in none. One that is killed in between has them twice: they are read
        once."""
        assert self.parts is not None
        self.parts.write(f"{len(self.parts.names):06d}", pd.DataFrame(self._rows[-self._open :]))
        self._rewrite([])
        self._open = 0

    def _rewrite(self, rows: list[dict[str, Any]]) -> None:
        """The rows that are in no part."""
        assert self.parts is not None
        self.parts.folder.mkdir(parents=True, exist_ok=True)
        replace_file(self.parts.folder / OPEN, lines_of(rows))


def discard(path: Path) -> None:
    """Remove the episodes of a table that is to be begun again."""
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
    """Make a folder of the file that earlier versions kept episodes in: the manifest in its first line, and a line
    each."""
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
