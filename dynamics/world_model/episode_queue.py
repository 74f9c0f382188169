"""`EpisodeQueue`: episodes on disk, the oldest of which make room for new ones, and sequences sampled from them."""

from __future__ import annotations

import json
import os
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from dynamics.errors import ConfigError
from dynamics.state import IntArray

__all__ = ["FIRST", "Column", "EpisodeQueue"]

FIRST = "first"
"""Column of a sample: whether a step is the first of its episode, or of the sequence."""

Column = tuple[tuple[int, ...], DTypeLike]
"""Shape and type of a column's entry of one step."""

_INDEX = "index.json"


class EpisodeQueue:
    """First-in, first-out queue of episodes on disk.

    Each column is a memory-mapped `.npy` file of `capacity` steps. An episode that does not fit any more replaces the
    oldest ones. `index.json` lists the complete episodes: a stopped process loses at most the episode that it was
    adding, and `EpisodeQueue.open` continues.

    Parameters
    ----------
    folder : new or empty folder.
    columns : shape and type of each column, by name.
    capacity : greatest number of steps, at least 1.

    Raises
    ------
    ConfigError
        If the folder holds something, there are no columns, or a name or the capacity is invalid.

    Attributes
    ----------
    folder, columns, capacity : as given.

    Examples
    --------
    >>> import numpy as np, tempfile
    >>> queue = EpisodeQueue(tempfile.mkdtemp(), {"frame": ((5, 64, 64), "uint8"), "reward": ((), "float32")}, 1000)
    >>> queue.add({"frame": np.zeros((30, 5, 64, 64), np.uint8), "reward": np.ones(30, np.float32)})
    >>> sample = queue.sample(16, 8, np.random.default_rng(0))
    >>> sample["frame"].shape, sample["first"].shape
    ((16, 8, 5, 64, 64), (16, 8))
    """

    def __init__(self, folder: str | Path, columns: Mapping[str, Column], capacity: int) -> None:
        path = Path(folder)
        if path.exists() and any(path.iterdir()):
            raise ConfigError(f"{path} is not empty; EpisodeQueue.open continues a queue")
        if not columns or FIRST in columns or not all(name.isidentifier() for name in columns):
            raise ConfigError(f"columns are identifiers other than {FIRST!r}, at least one; have {list(columns)}")
        if capacity < 1:
            raise ConfigError(f"a queue holds at least 1 step, not {capacity}")
        path.mkdir(parents=True, exist_ok=True)
        self._open(path, columns, capacity, "w+")
        self._write_index()

    @classmethod
    def open(cls, folder: str | Path) -> EpisodeQueue:
        """Continue the queue of a folder.

        Raises
        ------
        ConfigError
            If the folder holds no queue.
        """
        path = Path(folder)
        try:
            index = json.loads((path / _INDEX).read_text(encoding="utf-8"))
            columns = {name: (tuple(shape), kind) for name, (shape, kind) in index["columns"].items()}
            queue = cls.__new__(cls)
            queue._open(path, columns, int(index["capacity"]), "r+")
            queue._episodes.extend((int(start), int(length)) for start, length in index["episodes"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ConfigError(f"{path} holds no queue of episodes: {error}") from error
        queue._list_rows()
        return queue

    def _open(self, path: Path, columns: Mapping[str, Column], capacity: int, mode: Any) -> None:
        self.folder, self.columns, self.capacity = path, dict(columns), capacity
        self._arrays: dict[str, Any] = {}
        for name, (shape, kind) in columns.items():
            new: dict[str, Any] = {"dtype": np.dtype(kind), "shape": (capacity, *shape)} if mode == "w+" else {}
            self._arrays[name] = np.lib.format.open_memmap(path / f"{name}.npy", mode=mode, **new)
        self._episodes: deque[tuple[int, int]] = deque()
        self._list_rows()

    def __len__(self) -> int:
        """Number of steps."""
        return len(self._rows)

    @property
    def lengths(self) -> list[int]:
        """Number of steps of each episode, from the oldest to the newest."""
        return [length for _, length in self._episodes]

    def add(self, episode: Mapping[str, Any]) -> None:
        """Add an episode.

        Parameters
        ----------
        episode : for each column the entries of all steps, (steps, *shape).

        Raises
        ------
        ConfigError
            If a column is missing, unknown or of another shape, or the episode has no step or more than `capacity`.
        """
        steps = self._checked(episode)
        start = self._episodes[-1][0] + self._episodes[-1][1] if self._episodes else 0
        if start + steps > self.capacity:
            # Episodes are not split: those after the last one are older than all before it.
            while self._episodes and self._episodes[0][0] >= start:
                self._episodes.popleft()
            start = 0
        while self._episodes and start <= self._episodes[0][0] < start + steps:
            self._episodes.popleft()
        # The index forgets the episodes that are overwritten before they are.
        self._write_index()
        for name, array in self._arrays.items():
            array[start : start + steps] = episode[name]
            array.flush()
        self._episodes.append((start, steps))
        self._write_index()
        self._list_rows()

    def episode(self, i: int) -> dict[str, NDArray[Any]]:
        """Copy of the `i`-th oldest episode; -1 is the newest."""
        start, length = self._episodes[i]
        return {name: np.array(array[start : start + length]) for name, array in self._arrays.items()}

    def sample(self, batch: int, length: int, rng: np.random.Generator) -> dict[str, NDArray[Any]]:
        """Random sequences of consecutive steps. A sequence may go on into the next newer episode.

        Parameters
        ----------
        batch, length : number of sequences, and of steps of each.
        rng : draws the first steps, uniformly.

        Returns
        -------
        The columns, (batch, length, *shape), and `first`, (batch, length) bool.

        Raises
        ------
        ConfigError
            If the queue has fewer than `length` steps.
        """
        if not 1 <= length <= len(self):
            raise ConfigError(f"sequences have 1 to {len(self)} steps, as many as the queue; not {length}")
        begins = rng.integers(len(self) - length + 1, size=batch)
        places = begins[:, None] + np.arange(length)
        rows, first = self._rows[places], self._first[places]
        first[:, 0] = True
        return {**{name: array[rows] for name, array in self._arrays.items()}, FIRST: first}

    def _checked(self, episode: Mapping[str, Any]) -> int:
        """Number of steps of an episode; raises `ConfigError` if it does not fit the columns."""
        if set(episode) != set(self.columns):
            raise ConfigError(f"an episode has the columns {list(self.columns)}, not {list(episode)}")
        steps = len(episode[next(iter(self.columns))])
        if not 1 <= steps <= self.capacity:
            raise ConfigError(f"an episode has 1 to {self.capacity} steps, not {steps}")
        for name, (shape, _) in self.columns.items():
            found = np.shape(episode[name])
            if found != (steps, *shape):
                raise ConfigError(f"the column {name!r} of this episode has shape {(steps, *shape)}, not {found}")
        return steps

    def _list_rows(self) -> None:
        """Rows of all steps from the oldest to the newest, and those that begin an episode."""
        spans = [np.arange(start, start + length) for start, length in self._episodes]
        self._rows: IntArray = np.concatenate(spans) if spans else np.zeros(0, np.intp)
        self._first = np.zeros(len(self._rows), bool)
        self._first[np.cumsum([0, *self.lengths])[: len(self._episodes)]] = True

    def _write_index(self) -> None:
        kinds = {name: (list(shape), np.dtype(kind).str) for name, (shape, kind) in self.columns.items()}
        index = {"capacity": self.capacity, "columns": kinds, "episodes": list(self._episodes)}
        new = self.folder / f"{_INDEX}.new"
        new.write_text(json.dumps(index), encoding="utf-8")
        os.replace(new, self.folder / _INDEX)
