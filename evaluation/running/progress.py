"""Progress of a comparison on the terminal: episodes driven, and crashes so far."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import Progress

__all__ = ["EpisodeProgress"]


class EpisodeProgress:
    """A progress bar; if the output is no terminal, a line for each tenth of the episodes.

    Parameters
    ----------
    name : name of the comparison.
    total : number of episodes.
    shown : whether anything is printed.
    """

    def __init__(self, name: str, total: int, shown: bool) -> None:
        self._name, self._total, self._shown = name, total, shown
        self._console = Console(stderr=True)
        self._bar = Progress(disable=not (shown and self._console.is_terminal), transient=True, console=self._console)
        self._task = self._bar.add_task(name, total=total)
        self._counts: dict[str, list[int]] = {}
        """Crashes and episodes of each variant of the shield."""
        self._finished = self._tenths = 0

    def __enter__(self) -> EpisodeProgress:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def begin(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Count stored episodes, without printing."""
        self._count(rows)
        self._bar.update(self._task, completed=self._finished)

    def add(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Count new episodes, and print."""
        if not self._shown:
            return
        self._count(rows)
        self._bar.update(self._task, completed=self._finished, description=f"{self._name} ({self._crashes()})")
        tenths = 10 * self._finished // self._total
        if not self._console.is_terminal and tenths > self._tenths:
            self._tenths = tenths
            text = f"{self._name}: {self._finished} of {self._total} episodes ({self._crashes()})"
            self._console.print(text, highlight=False, soft_wrap=True)

    def _count(self, rows: Iterable[Mapping[str, Any]]) -> None:
        for row in rows:
            name = "no shield" if row["placement"] == "none" else f"{row['mode']} at {row['placement']}"
            counted = self._counts.setdefault(name, [0, 0])
            counted[0] += bool(row["crashed"])
            counted[1] += 1
            self._finished += 1

    def _crashes(self) -> str:
        """Crashes of each variant so far, as a text."""
        return ", ".join(f"{name}: {crashed} of {count} crashed" for name, (crashed, count) in self._counts.items())
