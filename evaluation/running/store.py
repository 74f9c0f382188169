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

from dynamics.errors import ConfigError, DataError
from evaluation.running.manifest import check_fits, extended, provenance

__all__ = ["KEY", "Parts", "Store", "discard", "is_store", "plain_rows", "read_store"]

KEY = ("setting", "policy", "door", "mode", "seed")
"""Columns that tell one episode from every other of a comparison."""
_AGAIN = "--force begins again, another --output keeps both"
_PART = 1_000
"""Episodes that are kept a line each before they become a part."""
_SYNC = 1.0
"""At least so much time lies between two waits for the disk [s]; one takes milliseconds, as long as a compiled episode.
Until then the operating system has what was written, which outlives the process."""
_MANIFEST, _PARTS, _OPEN = "manifest.json", "parts", "open.jsonl"


class Parts:
    """A folder of Parquet parts and their manifest. Several processes may write parts of different names.

    Parameters
    ----------
    folder : which need not be there.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)

    @property
    def manifest(self) -> dict[str, Any] | None:
        """What made the rows; None where nothing is there yet.

        Raises
        ------
        DataError
            If it is no JSON.
        """
        path = self.folder / _MANIFEST
        if not path.is_file():
            return None
        try:
            found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise DataError(f"{path} is damaged: {error}") from None
        return found

    def claim(self, made: Mapping[str, Any]) -> None:
        """Write the manifest; the folder is made.

        Raises
        ------
        ConfigError
            If it cannot be written.
        """
        try:
            (self.folder / _PARTS).mkdir(parents=True, exist_ok=True)
            _replace(self.folder / _MANIFEST, (json.dumps(made, indent=2) + "\n").encode())
        except OSError as error:
            raise ConfigError(f"{self.folder} cannot be written: {error.strerror}") from None

    @property
    def names(self) -> list[str]:
        """Of the parts that are there, in order."""
        return sorted(path.stem for path in (self.folder / _PARTS).glob("*.parquet"))

    def has(self, name: str) -> bool:
        """Whether a part is there."""
        return self._path(name).is_file()

    def read(self, name: str) -> pd.DataFrame:
        """A part, with what was kept in its `attrs`."""
        return pd.read_parquet(self._path(name))

    def record(self, name: str) -> dict[str, Any] | None:
        """What made a part, where it says so itself; None where it does not, and without the part."""
        if not self.has(name):
            return None
        found: dict[str, Any] | None = pd.read_parquet(self._path(name), columns=["seed"]).attrs.get("made")
        return found

    def write(self, name: str, frame: pd.DataFrame, made: Mapping[str, Any] | None = None) -> None:
        """Write a part, whole or not at all; `made` is kept in it (see `record`)."""
        path = self._path(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        if made is not None:
            frame = frame.copy(deep=False)
            frame.attrs = {"made": dict(made)}
        written = path.with_suffix(f".{os.getpid()}.partial")
        frame.to_parquet(written, index=False)
        with written.open("rb+") as file:
            os.fsync(file.fileno())
        written.replace(path)

    def _path(self, name: str) -> Path:
        return self.folder / _PARTS / f"{name}.parquet"


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
        elif store.parts.names or (folder / _OPEN).exists():
            raise ConfigError(f"{folder} holds episodes without a {_MANIFEST} that says how they were made; {instead}")
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

    def done(self, setting: str, policy: str) -> set[tuple[str, str, int]]:
        """Door, mode and seed of those that need not be driven again."""
        here = [row for row in self._rows if (row["setting"], row["policy"]) == (setting, policy)]
        return {(row["door"], row["mode"], row["seed"]) for row in here}

    def add(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Write episodes to the file, where they outlive this process; at most once a second, wait for the disk."""
        # What comes back from the file and what went in are the same then.
        plain = [json.loads(json.dumps(row, default=_plain)) for row in rows]
        self._rows += plain
        if self.parts is None:
            return
        with (self.parts.folder / _OPEN).open("ab") as file:
            file.write(_lines(plain))
            file.flush()
            if time.monotonic() - self._synced >= _SYNC:
                os.fsync(file.fileno())
                self._synced = time.monotonic()
        self._open += len(plain)
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
        self._rows = _once(rows)
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
        _replace(self.parts.folder / _OPEN, _lines(rows))


def is_store(path: str | Path) -> bool:
    """Whether a folder is a store."""
    return (Path(path) / _MANIFEST).is_file() and (Path(path) / _PARTS).is_dir()


def read_store(folder: str | Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The manifest of a store, and its rows: those of its parts, by name, and those after. An episode that stands twice
    is there once.

    Raises
    ------
    ConfigError
        If there is none.
    DataError
        If it cannot be read.
    """
    parts = Parts(folder)
    made = parts.manifest
    if made is None:
        raise ConfigError(f"{folder} is no store of episodes: it has no {_MANIFEST}")
    rows = [row for name in parts.names for row in plain_rows(parts.read(name))]
    path = parts.folder / _OPEN
    if path.is_file():
        rows += _read_lines(path)
    return made, _once(rows)


def plain_rows(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of a table as `EpisodeRecord.row` made them: what is unknown is None or "", and not NaN."""
    empty = {"violations": None, "success": None, "rules": ""}
    rows = []
    for row in frame.to_dict("records"):
        if "latencies_ms" in row:
            row["latencies_ms"] = [float(each) for each in row["latencies_ms"]]
        blank = {key: nothing for key, nothing in empty.items() if key in row and pd.isna(row[key])}
        rows.append({**{str(key): value for key, value in row.items()}, **blank})
    return rows


def _once(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows, each episode once; those of other experiments than comparisons as they are."""
    found: dict[Any, dict[str, Any]] = {}
    for number, row in enumerate(rows):
        found.setdefault(tuple(row[name] for name in KEY) if row.keys() >= set(KEY) else number, row)
    return list(found.values())


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
    lines = _read_lines(folder)
    if partial.exists():
        shutil.rmtree(partial)
    if lines:
        Parts(partial).claim(lines[0])
        _replace(partial / _OPEN, _lines(lines[1:]))
    folder.unlink()
    if lines:
        partial.rename(folder)


def _read_lines(path: Path) -> list[dict[str, Any]]:
    """What each line says, without one that was not written to its end."""
    whole, _, _torn = path.read_bytes().rpartition(b"\n")
    try:
        return [json.loads(line) for line in whole.split(b"\n")] if whole else []
    except ValueError as error:
        raise DataError(f"{path} is damaged: {error}; --force begins again") from None


def _lines(rows: Iterable[Mapping[str, Any]]) -> bytes:
    return b"".join(json.dumps(row, default=_plain).encode() + b"\n" for row in rows)


def _replace(path: Path, content: bytes) -> None:
    """Write a file, whole or not at all."""
    partial = path.with_name(path.name + ".partial")
    with partial.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)


def _plain(value: Any) -> Any:
    """numpy's numbers as Python's."""
    return value.item()
