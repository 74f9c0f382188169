"""Where a comparison goes: tables on the terminal, and files."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console

from evaluation.names import TABLE_ENDINGS
from shield.errors import ConfigError

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["check_output", "report"]

_out = Console()


def check_output(path: Path, force: bool, resume: bool = False) -> None:
    """Refuse what cannot be written before hours of driving, not after.

    Parameters
    ----------
    path : of the table. force : whether what is there is begun again. resume : whether it is gone on with.
    """
    if path.suffix not in TABLE_ENDINGS:
        raise ConfigError(f"--output {path.name!r} must end in {' or '.join(TABLE_ENDINGS)}")
    if force and resume:
        raise ConfigError("--force begins again and --resume goes on: give one of them")
    if path.exists() and not (force or resume):
        raise ConfigError(f"--output {path} exists already; --resume extends it, --force overwrites it")
    if force:
        path.with_name(path.name + ".episodes").unlink(missing_ok=True)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise ConfigError(f"--output {path} cannot be written: {error.strerror}") from None


def report(episodes: pd.DataFrame, output: Path | None, markdown: bool, made: dict[str, Any] | None = None) -> None:
    """Print the tables of some episodes, and write them where asked."""
    from evaluation.measuring.metrics import compare, summarise
    from evaluation.report.table import COMPARISON, SUMMARY, rich_table, write_table
    from evaluation.report.table import markdown as to_markdown

    summary, comparison = summarise(episodes), compare(episodes)
    tables = [(summary, SUMMARY)] + ([(comparison, COMPARISON)] if len(comparison) else [])
    for frame, columns in tables:
        if markdown:
            typer.echo(to_markdown(frame, columns) + "\n")
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
