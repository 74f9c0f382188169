"""The command that repeats the report's experiments: `shield reproduce`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from evaluation.commands.asking import check_jobs, split
from shield.errors import ConfigError

__all__ = ["add_reproducing"]

_err = Console(stderr=True, highlight=False)
_QUICK = {"seeds": 2, "episodes": 60, "pooled": 3, "steps": 2_048}


class Table(StrEnum):
    """Which table."""

    HIGHWAY = "highway"


def reproduce_command(
    table: Annotated[Table, typer.Argument(help="Which table of the report.")] = Table.HIGHWAY,
    preset: Annotated[
        str,
        typer.Option(help="as-coded: what the published script does, its mistakes included; as-written: the text."),
    ] = "as-coded",
    variant: Annotated[
        list[str] | None, typer.Option(help="Only these rows (repeatable, or a comma list); all by default.")
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Training seeds.")] = 10,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of each row and training seed.")] = 1_000,
    pooled: Annotated[int, typer.Option(min=1, help="The same of rows that are driven one episode at a time.")] = 30,
    steps: Annotated[int | None, typer.Option(min=1, help="Training steps; by default the preset's.")] = None,
    quick: Annotated[
        bool,
        typer.Option("--quick", help="2 training seeds, 60 episodes and 2,048 steps, whatever else is asked for."),
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Folder; what is finished there is not done again.")] = None,
    jobs: Annotated[int, typer.Option(help="Processes, one training seed each; -1 for one per core.")] = -1,
) -> None:
    """Train and drive the report's variants and this project's, and print their table beside what was published.

    Writes to --out the models, every episode (episodes.parquet and .csv), table.md, verdict.json
    and manifest.json. The same command goes on where it was stopped.
    """
    check_jobs(jobs)
    from evaluation.reproduction.presets import get_preset
    from evaluation.reproduction.variants import get_variants

    chosen, rows = get_preset(preset), get_variants(split(variant or []))
    if quick:
        seeds, episodes, pooled, steps = _QUICK["seeds"], _QUICK["episodes"], _QUICK["pooled"], _QUICK["steps"]
    folder = out or Path("runs", "reproduce", f"{table.value}-{preset}" + ("-quick" if quick else ""))
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"{folder} is a file; --out is a folder")
    from evaluation.reproduction.running import Reproduction, run

    asked = Reproduction(chosen, tuple(rows), seeds, episodes, pooled, chosen.steps if steps is None else steps)
    found = run(asked, folder, jobs, lambda line: _err.print(line, soft_wrap=True))
    from evaluation.reproduction.writing import write

    typer.echo(write(found, asked, folder))


def add_reproducing(app: typer.Typer) -> None:
    """Give the application the command."""
    app.command("reproduce")(reproduce_command)
