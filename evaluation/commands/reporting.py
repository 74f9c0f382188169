"""Output of a comparison: tables on the terminal, and files."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console

from evaluation.names import TABLE_ENDINGS
from shield.errors import ConfigError

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["TableFormat", "check_output", "check_steps_path", "check_writable", "report"]

_out = Console()


def check_output(path: Path, force: bool, resume: bool = False) -> None:
    """Check that the table can be written, before the episodes are driven.

    Parameters
    ----------
    path : path of the table.
    force : whether an existing run is discarded.
    resume : whether an existing run is continued.

    Raises
    ------
    ConfigError
        If the file has another ending, exists without `force` or `resume`, or cannot be written.
    """
    if path.suffix not in TABLE_ENDINGS:
        raise ConfigError(f"--output {path.name!r} must end in {' or '.join(TABLE_ENDINGS)}")
    if force and resume:
        raise ConfigError("--force begins again and --resume goes on: give one of them")
    if path.exists() and not (force or resume):
        raise ConfigError(f"--output {path} exists already; --resume extends it, --force overwrites it")
    if force:
        from evaluation.running.store import discard

        discard(path)
    check_writable(path)


def check_steps_path(path: Path, force: bool, resume: bool) -> None:
    """Check that the file of decisions can be written, and does not exist unless it may be overwritten.

    Raises
    ------
    ConfigError
        With the reason.
    """
    if path.suffix != ".parquet":
        raise ConfigError(f"--steps {path.name!r} must end in .parquet")
    if path.exists() and not (force or resume):
        raise ConfigError(f"--steps {path} exists already; --force overwrites it")
    check_writable(path)


def check_writable(path: Path) -> None:
    """Check that a file can be written into the folder of `path`, which is created.

    Raises
    ------
    ConfigError
        With the reason.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {error.strerror}") from None


class TableFormat(StrEnum):
    """Format of printed tables."""

    TERMINAL = "terminal"
    MARKDOWN = "markdown"
    LATEX = "latex"

    @classmethod
    def of(cls, markdown: bool, latex: bool) -> TableFormat:
        """The format for these flags; raises `ConfigError` if both are set."""
        if markdown and latex:
            raise ConfigError("give one of --markdown and --latex")
        return cls.MARKDOWN if markdown else cls.LATEX if latex else cls.TERMINAL


def report(
    episodes: pd.DataFrame,
    output: Path | None = None,
    form: TableFormat = TableFormat.TERMINAL,
    made: dict[str, Any] | None = None,
) -> None:
    """Print the tables of some episodes, and write them if `output` is given."""
    from evaluation.measuring.metrics import compare, summarise
    from evaluation.report.table import COMPARISON, SUMMARY, latex, markdown, rich_table, write_table

    summary, comparison = summarise(episodes), compare(episodes)
    tables = [(summary, SUMMARY)] + ([(comparison, COMPARISON)] if len(comparison) else [])
    for frame, columns in tables:
        if form is not TableFormat.TERMINAL:
            typer.echo((markdown if form is TableFormat.MARKDOWN else latex)(frame, columns) + "\n")
            continue
        for _, part in frame.groupby(["setting", "policy"], sort=False):
            _out.print(rich_table(part, columns))
    if output is None:
        return
    for frame in (episodes, summary, comparison):
        frame.attrs["made"] = made or {}
    paths = [write_table(episodes, output)]
    paths.append(write_table(summary, output.with_stem(f"{output.stem}-summary")))
    if len(comparison):
        paths.append(write_table(comparison, output.with_stem(f"{output.stem}-comparison")))
    _out.print("wrote " + ", ".join(str(path) for path in paths))
