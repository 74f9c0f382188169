"""The command `reproduce`, which repeats a report's experiments."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from evaluation.commands.options_command import one_option_a_field
from evaluation.commands.shared_options import check_jobs, split
from shield.errors import ConfigError

__all__ = ["add_reproducing"]

_err = Console(stderr=True, highlight=False)
_QUICK_SHIELDS = 5


class Table(StrEnum):
    """Table to reproduce."""

    HIGHWAY = "highway"
    ROUNDABOUT = "roundabout"
    SHIELDS = "shields"


@dataclass(frozen=True)
class ReproduceOptions:
    """The options of `shield reproduce`."""

    table: Annotated[
        Table,
        typer.Argument(
            help="highway, roundabout: the report's variants; shields: comparison of shields on several roads."
        ),
    ] = Table.HIGHWAY
    preset: Annotated[
        str,
        typer.Option(help="as-coded: the published script, with its mistakes; as-written: the text."),
    ] = "as-coded"
    variant: Annotated[
        list[str] | None, typer.Option(help="Only these rows (repeatable, or a comma list); all by default.")
    ] = None
    seeds: Annotated[int, typer.Option(min=1, help="Training seeds.")] = 10
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of each row and training seed.")] = 1_000
    pooled: Annotated[
        int,
        typer.Option(min=1, help="Episodes of slow rows, which are driven one at a time or simulated on a roundabout."),
    ] = 30
    steps: Annotated[int | None, typer.Option(min=1, help="Training steps; by default the preset's.")] = None
    road: Annotated[
        list[str] | None, typer.Option(help="Only these roads of the table shields (repeatable, or a comma list).")
    ] = None
    shield: Annotated[
        list[str] | None, typer.Option(help="Only these shields of the table shields (repeatable, or a comma list).")
    ] = None
    quick: Annotated[
        bool,
        typer.Option(
            "--quick",
            help="2 training seeds, 60 episodes and 2,048 steps, or 5 episodes of each shield, instead of other"
            " options.",
        ),
    ] = False
    out: Annotated[Path | None, typer.Option(help="Folder; finished parts in it are reused.")] = None
    jobs: Annotated[int, typer.Option(help="Processes, one training seed each; -1 for one per core.")] = -1


def reproduce_command(options: ReproduceOptions) -> None:
    """Train and drive the report's and this project's variants, or compare shields, beside published numbers.

    Writes to --out the models, every episode (episodes.parquet and .csv), table.md, verdict.json
    and manifest.json. The same command continues a stopped run.
    """
    check_jobs(options.jobs)
    named = options.table.value if options.table is Table.SHIELDS else f"{options.table.value}-{options.preset}"
    folder = options.out or Path("runs", "reproduce", named + ("-quick" if options.quick else ""))
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"{folder} is a file; --out is a folder")

    def tell(line: str) -> None:
        _err.print(line, soft_wrap=True)

    if options.table is Table.SHIELDS:
        if options.variant:
            raise ConfigError("--variant goes with highway and roundabout; of shields have --road and --shield")
        from evaluation.reproduction.shields_table import compare_shields

        count = _QUICK_SHIELDS if options.quick else options.episodes
        typer.echo(
            compare_shields(folder, count, split(options.road or []), split(options.shield or []), options.jobs, tell)
        )
        return
    if options.road or options.shield:
        raise ConfigError("--road and --shield go with the table shields; of the others have --variant")
    from evaluation.reproduction.presets import get_preset
    from evaluation.reproduction.variants import get_variants

    get_preset(options.preset, options.table.value)
    get_variants(split(options.variant or []), options.table.value)  # report wrong names before slow imports
    from evaluation.reproduction.api import QUICK, reproduce

    counts = {"seeds": options.seeds, "episodes": options.episodes, "pooled": options.pooled}
    if options.quick:
        counts = QUICK
    elif options.steps is not None:
        counts["steps"] = options.steps
    rows = split(options.variant or [])
    typer.echo(reproduce(options.preset, rows, folder, options.jobs, tell, road=options.table.value, **counts))


def add_reproducing(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("reproduce")(one_option_a_field(reproduce_command, ReproduceOptions))
