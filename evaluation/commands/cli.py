"""The command `shield`, with the demos; the other commands come from other modules."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from evaluation.commands.certifying import add_certifying
from evaluation.commands.dynamics import dynamics_app
from evaluation.commands.evaluating import add_evaluating
from evaluation.commands.monitoring import monitor_app
from evaluation.commands.names import DEMO_POLICY, DEMO_SETTING, EVALUATION_SEED
from evaluation.commands.replaying import add_replaying
from evaluation.commands.reporting import report
from evaluation.commands.reproducing import add_reproducing
from evaluation.commands.showing import add_showing
from evaluation.commands.training import add_training
from evaluation.commands.warming import add_warming
from evaluation.commands.world_model import world_model_app
from shield import __version__
from shield.errors import ShieldError

__all__ = ["app", "main"]

app = typer.Typer(
    help="A runtime safety shield around driving policies on highway-env.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=False,
)
app.add_typer(dynamics_app, name="dynamics")
app.add_typer(monitor_app, name="monitor")
app.add_typer(world_model_app, name="world-model")
_out, _err = Console(), Console(stderr=True, highlight=False)


def _version(show: bool) -> None:
    if show:
        typer.echo(f"highway-shield {__version__}")
        raise typer.Exit


@app.callback()
def options(
    _: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """A runtime safety shield around driving policies on highway-env."""


add_training(app)
add_evaluating(app)
add_certifying(app)
add_reproducing(app)
add_replaying(app)


@app.command()
def demo(
    episodes: Annotated[int, typer.Option(min=1, help="Episodes for each row.")] = 20,
    output: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs", "demo"),
    jobs: Annotated[int, typer.Option(help="Processes; -1 for one per core.")] = -1,
    env_id: Annotated[
        str | None, typer.Option(help="Always FASTER on another road instead, verified by simulation, and a picture.")
    ] = None,
) -> None:
    """Drive the bundled PPO with and without the shield, and film overrides.

    Takes less than two minutes on two cores. Writes the episodes, their summary, and
    override.gif, with a bundled agent that was trained to crash, and the shield.
    """
    if env_id is not None:
        from evaluation.commands.road_demo import road_demo

        picture = road_demo(env_id, range(EVALUATION_SEED, EVALUATION_SEED + episodes), output, jobs)
        _out.print(f"wrote {picture}")
        return
    from evaluation.report.video import film_override
    from evaluation.running.episodes import RunOptions, run_paired
    from evaluation.running.records import make_variants

    frame = run_paired(
        DEMO_SETTING,
        DEMO_POLICY,
        make_variants(["none", "full"], ["env"]),
        range(EVALUATION_SEED, EVALUATION_SEED + episodes),
        jobs=jobs,
        run=RunOptions(progress=True),
    )
    report(frame, output / "episodes.parquet")
    film = film_override(output / "override.gif")
    _out.print(f"wrote {film.path} (seed {film.seed}, {film.overrides} decisions overridden)")


@app.command("cem-demo")
def cem_demo_command(
    output: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs", "cem-demo"),
) -> None:
    """Learn to park: collect, fit, plan, and film the result.

    Takes less than two minutes on one core. Writes parking.gif and error.png.
    """
    from evaluation.commands.cem_demo import cem_demo

    for path in cem_demo(output, _out.print):
        _out.print(f"wrote {path}")


add_showing(app)
add_warming(app)


def main() -> None:
    """Entry point: errors of the project become one line and exit code 2.

    The working directory is importable, for `--env-id module:id`. It comes last, so that its files hide no installed
    module.
    """
    if (here := str(Path.cwd())) not in sys.path:
        sys.path.append(here)
    try:
        app()
    except ShieldError as error:
        _err.print(f"Error: {error}", style="red", markup=False, soft_wrap=True)
        sys.exit(2)


if __name__ == "__main__":
    main()
