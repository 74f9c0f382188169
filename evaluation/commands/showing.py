"""The commands that show results: `film`, `picture`, `plot`, `table`, `figures`, `course`, `gallery` and others."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from evaluation.commands.names import DEMO_POLICY
from evaluation.commands.reporting import TableFormat, report
from evaluation.commands.shared_options import EnvConfig, EnvId, NamedSetting, read_setting
from evaluation.names import FIRST_EVALUATION_SEED, check_policy
from shield.config import PROFILES, ShieldConfig
from shield.errors import ConfigError

__all__ = ["add_showing"]

_out, _err = Console(), Console(stderr=True, highlight=False)


def film_command(
    output: Annotated[Path, typer.Argument(help="The .gif to write.")] = Path("runs", "film.gif"),
    setting: NamedSetting = None,
    env_id: EnvId = None,
    env_config: EnvConfig = None,
    policy: Annotated[
        str | None,
        typer.Option(help=f"Name of a policy, or an SB3 .zip [{DEMO_POLICY}; random with --env-id]."),
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, help=f"First seed of the search for an override, below {FIRST_EVALUATION_SEED}.")
    ] = 0,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file that exists.")] = False,
) -> None:
    """Film a policy with the shield, around one of its overrides, or the first episode without any override."""
    if output.exists() and not force:
        raise ConfigError(f"{output} exists already; --force overwrites it")
    policy = policy or (DEMO_POLICY if env_id is None else "random")
    check_policy(policy)
    where = read_setting(setting, env_id, env_config)
    from evaluation.report.video import film_override

    with _err.status("looking for an override") as status:

        def progress(tried: int, most: int) -> None:
            text = f"looking for an override: episode {tried + 1} of {most} at most (seed {seed + tried})"
            status.update(text)
            if not _err.is_terminal and tried % 10 == 0:
                _err.print(text)

        made = film_override(output, where, policy, seed, progress)
    _out.print(f"wrote {made.path} (seed {made.seed}, {made.overrides} decisions overridden)")


def picture_command(
    output: Annotated[Path, typer.Argument(help="The .png to write.")] = Path("docs", "images", "override.png"),
) -> None:
    """Write a still of an override, as in the README."""
    from evaluation.report.video import still_of_override

    _out.print(f"wrote {still_of_override(output)}")


def plot_command(
    episodes: Annotated[Path, typer.Argument(help="File of `shield evaluate --output`, .csv or .parquet.")],
    output: Annotated[
        Path | None, typer.Option(help="The .png, .svg or .pdf to write; by default beside the episodes, as .png.")
    ] = None,
    noise: Annotated[
        bool, typer.Option("--noise", help="Plot rows with sensors such as normalised-0.2 against their noise.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file that exists.")] = False,
) -> None:
    """Plot crash rates, returns, overrides by reason and least gaps."""
    from evaluation.report.noise_curves import plot_noise
    from evaluation.report.plots import plot_episodes
    from evaluation.report.table import read_episodes

    path = output or episodes.with_suffix(".png")
    if path.exists() and not force:
        raise ConfigError(f"{path} exists already; --force overwrites it")
    plot = plot_noise if noise else plot_episodes
    _out.print(f"wrote {plot(read_episodes(episodes), path)}")


def report_command(
    runs: Annotated[list[Path], typer.Argument(help="Files of `shield evaluate --output`, .csv or .parquet.")],
    output: Annotated[
        Path | None, typer.Option(help="The .html to write; by default beside the first run, under its name.")
    ] = None,
    replays: Annotated[
        int,
        typer.Option(min=0, help="Number of each run's worst shielded episodes with a replay page."),
    ] = 3,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file that exists.")] = False,
) -> None:
    """Write one offline page: tables, charts, and the worst episodes of some runs with their replays."""
    path = output or runs[0].with_suffix(".html")
    if path.exists() and not force:
        raise ConfigError(f"{path} exists already; --force overwrites it")
    from evaluation.replay.run_file import write_replay
    from evaluation.report.html_report import write_report

    with _err.status("writing the report") as status:

        def write(run: Path, number: int, policy: str, page: Path) -> str:
            status.update(f"driving episode {number} of {run.name} again, for its replay")
            return write_replay(run, number, policy, page)

        written = write_report(runs, path, replays, write)
    _out.print(f"wrote {written}")


def table_command(
    episodes: Annotated[Path, typer.Argument(help="File of `shield evaluate --output`, .csv or .parquet.")],
    markdown: Annotated[bool, typer.Option("--markdown", help="Print Markdown.")] = False,
    latex: Annotated[bool, typer.Option("--latex", help="Print LaTeX, for the package booktabs.")] = False,
) -> None:
    """Print the tables of a file of episodes."""
    form = TableFormat.of(markdown, latex)
    if not episodes.is_file():
        raise ConfigError(f"there is no file {episodes}")
    from evaluation.report.table import read_episodes

    report(read_episodes(episodes), form=form)


def figures_command(
    output: Annotated[Path, typer.Option(help="Folder for the pictures.")] = Path("docs", "images"),
) -> None:
    """Draw the figures about the shield's decision."""
    from evaluation.report.figures import write_figures

    for path in write_figures(output):
        _out.print(f"wrote {path}")


def course_command(
    output: Annotated[Path, typer.Argument(help="The .png to write.")] = Path("docs", "images", "complex-roads.png"),
    seed: Annotated[int, typer.Option(min=0, help="Seed of the traffic.")] = 0,
) -> None:
    """Draw the roads of ComplexRoads-v0."""
    from evaluation.report.course_picture import draw_map

    _out.print(f"wrote {draw_map(output, seed=seed)}")


def gallery_command(
    output: Annotated[
        Path | None, typer.Argument(help="The .png to write; by default docs/images/roads.png or worst-case-roads.png.")
    ] = None,
    env_id: Annotated[
        list[str] | None, typer.Option(help="One road (repeatable); by default every supported road.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="First seed of the search for a decision.")] = 0,
    worst_case: Annotated[
        bool, typer.Option("--worst-case", help="Draw reachable areas, conflict zones and yielding vehicles.")
    ] = False,
) -> None:
    """Draw a decision on every road network: overrides in simulated traffic, or the worst case."""
    if worst_case:
        from evaluation.report.worst_case_view import VIEWED, draw_worst_cases

        path = output or Path("docs", "images", "worst-case-roads.png")
        _out.print(f"wrote {draw_worst_cases(path, env_id or VIEWED, seed=seed)}")
        return
    from evaluation.report.gallery import ROADS, draw_gallery

    _out.print(f"wrote {draw_gallery(output or Path('docs', 'images', 'roads.png'), env_id or ROADS, seed)}")


def settings_command() -> None:
    """List the named environments."""
    from evaluation.settings import SETTINGS

    table = Table("setting", "environment", "")
    for setting in SETTINGS.values():
        table.add_row(setting.name, setting.env_id, setting.description)
    _out.print(table)


def config_command(
    profile: Annotated[str, typer.Option(help=f"One of {', '.join(PROFILES)}.")] = "default",
) -> None:
    """Print the shield's settings as TOML: the default ones, those for meta-actions alone, those
    for road networks, or those that simulate the traffic."""
    typer.echo(ShieldConfig.profile(profile).to_toml(), nl=False)


def add_showing(app: typer.Typer) -> None:
    """Add these commands to the application."""
    app.command("film")(film_command)
    app.command("picture")(picture_command)
    app.command("plot")(plot_command)
    app.command("table")(table_command)
    app.command("report")(report_command)
    app.command("figures")(figures_command)
    app.command("course")(course_command)
    app.command("gallery")(gallery_command)
    app.command("settings")(settings_command)
    app.command("config")(config_command)
