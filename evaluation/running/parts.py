"""A folder of Parquet parts, each written atomically, with a manifest of their origin."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from dynamics.errors import ConfigError, DataError
from evaluation.measuring.columns import with_present_columns

__all__ = ["MANIFEST", "PARTS", "Parts", "replace_file"]

MANIFEST, PARTS = "manifest.json", "parts"
"""Names in the folder of a store."""


class Parts:
    """A folder of Parquet parts and their manifest. Several processes may write parts of different names.

    Parameters
    ----------
    folder : the folder; `claim` creates it.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)

    @property
    def manifest(self) -> dict[str, Any] | None:
        """The manifest of the rows; None before the first `claim`.

        Raises
        ------
        DataError
            If the file is no JSON.
        """
        path = self.folder / MANIFEST
        if not path.is_file():
            return None
        try:
            found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise DataError(f"{path} is damaged: {error}") from None
        return found

    def claim(self, made: Mapping[str, Any]) -> None:
        """Write the manifest, and create the folder if it does not exist.

        Raises
        ------
        ConfigError
            If the folder cannot be written.
        """
        try:
            (self.folder / PARTS).mkdir(parents=True, exist_ok=True)
            replace_file(self.folder / MANIFEST, (json.dumps(made, indent=2) + "\n").encode())
        except OSError as error:
            raise ConfigError(f"{self.folder} cannot be written: {error.strerror}") from None

    @property
    def names(self) -> list[str]:
        """Names of the parts, in order."""
        return sorted(path.stem for path in (self.folder / PARTS).glob("*.parquet"))

    def has(self, name: str) -> bool:
        """Whether a part exists."""
        return self._path(name).is_file()

    def read(self, name: str) -> pd.DataFrame:
        """Read a part, with its `attrs`."""
        return with_present_columns(pd.read_parquet(self._path(name)))

    def record(self, name: str) -> dict[str, Any] | None:
        """Origin of a part (see `write`); None if the part has none or does not exist."""
        if not self.has(name):
            return None
        found: dict[str, Any] | None = pd.read_parquet(self._path(name), columns=["seed"]).attrs.get("made")
        return found

    def write(self, name: str, frame: pd.DataFrame, made: Mapping[str, Any] | None = None) -> None:
        """Write a part atomically; `made` is stored in it (see `record`)."""
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
        return self.folder / PARTS / f"{name}.parquet"


def replace_file(path: Path, content: bytes) -> None:
    """Write a file atomically."""
    partial = path.with_name(path.name + ".partial")
    with partial.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
