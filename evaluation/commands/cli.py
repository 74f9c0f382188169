"""The command `shield`: train, evaluate, demo, picture, figures, config, dynamics."""

from __future__ import annotations

import sys
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from evaluation.commands.certifying import add_certifying
from evaluation.commands.dynamics import dynamics_app
from evaluation.commands.names import DEMO_POLICY, DEMO_SETTING
from evaluation.learning.algorithms import ALGORITHMS
from evaluation.learning.recipes import RECIPES
from evaluation.names import BASELINES, FIRST_EVALUATION_SEED, MODELS, SIMULATORS, TRAINABLE
from shield.config import MODES, PROFILES, ShieldConfig
from shield.errors import ConfigError, ShieldError

if TYPE_CHECKING:
    import pandas as pd

    from evaluation.settings import Setting

__all__ = ["app", "main"]

EVALUATION_SEED = 100_000
"""Seed of the first evaluation episode, unless another is asked for."""

_POLICIES = [DEMO_POLICY]

app = typer.Typer(
    help="A runtime safety shield around driving policies on highway-env.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=False,
)
app.add_typer(dynamics_app, name="dynamics")
_out, _err = Console(), Console(stderr=True, highlight=False)


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"highway-shield {version('highway-shield')}")
        raise typer.Exit


@app.callback()
def options(
    _: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """A runtime safety shield around driving policies on highway-env."""


class Door(StrEnum):
    """Where the shield stands."""

    ENV = "env"
    POLICY = "policy"
    ACTIONS = "actions"
    ALL = "all"


@app.command("train")
def train_command(
    recipe: Annotated[str | None, typer.Option(help=f"Train a reference policy: {', '.join(RECIPES)}.")] = None,
    setting: Annotated[str | None, typer.Option(help="Environment setting to train in, without --recipe.")] = None,
    algorithm: Annotated[str, typer.Option(help=f"One of {', '.join(TRAINABLE)}.")] = "ppo",
    steps: Annotated[
        int | None, typer.Option(help="Training steps (decisions); by default the recipe's, or 10,000.")
    ] = None,
    seed: Annotated[int, typer.Option(help=f"Training seed, below {FIRST_EVALUATION_SEED}.")] = 0,
    output: Annotated[Path | None, typer.Option(help="The zip file to write; a manifest goes beside it.")] = None,
    simulator: Annotated[
        str,
        typer.Option(help=f"One of {', '.join(SIMULATORS)}; the compiled highway teaches the same, bit for bit."),
    ] = SIMULATORS[0],
) -> None:
    """Train a policy on one core and save it with a manifest that says how."""
    if (recipe is None) == (setting is None):
        raise ConfigError("give either --recipe or --setting")
    from evaluation.learning.training import train, train_recipe

    if recipe is not None:
        trained = train_recipe(recipe, output, steps=steps, simulator=simulator)
    else:
        assert setting is not None
        path = output or Path("runs", "policies", f"{algorithm}-{setting}.zip")
        decisions = 10_000 if steps is None else steps
        trained = train(setting, algorithm, decisions, seed, output=path, simulator=simulator)
    told = f"{trained.manifest['training_seconds']} s in {trained.manifest['simulator']}"
    _out.print(f"wrote {trained.path} ({told})")


@app.command()
def evaluate(
    setting: Annotated[
        list[str] | None,
        typer.Option(help=f"Named environment (repeatable, or a comma list; see `shield settings`) [{DEMO_SETTING}]."),
    ] = None,
    env_id: Annotated[
        str | None, typer.Option(help="Any environment by its Gymnasium id instead, such as highway-v0 or module:id.")
    ] = None,
    env_config: Annotated[
        Path | None, typer.Option(help="TOML file of what differs from the default configuration of --env-id.")
    ] = None,
    policy: Annotated[
        list[str],
        typer.Option(help=f"{', '.join(BASELINES)}, a reference policy, or an SB3 .zip (repeatable, or a comma list)."),
    ] = _POLICIES,
    shield: Annotated[
        list[str] | None,
        typer.Option(
            help=f"Shield modes: {', '.join(MODES)} (repeatable, or a comma list)."
            " By default none and full; none alone where they cannot read the road."
        ),
    ] = None,
    door: Annotated[
        Door,
        typer.Option(
            help="env: ShieldedEnv, around the environment; policy: Shield, around the policy;"
            " actions: the same, which chooses among actions and leaves the frames between alone; all: one after the"
            " other."
        ),
    ] = Door.ENV,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes for each row.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first episode; the others follow.")] = EVALUATION_SEED,
    jobs: Annotated[int, typer.Option(help="Processes; -1 for one per core.")] = -1,
    algorithm: Annotated[
        str | None,
        typer.Option(help=f"Algorithm of a .zip, where the file does not tell: {', '.join(sorted(ALGORITHMS))}."),
    ] = None,
    model: Annotated[
        str,
        typer.Option(
            help=f"What mpc, and the predictive filter of the shield at door env, plans with: {', '.join(MODELS)}, or"
            " a folder from `shield dynamics fit --setting`. The shield verifies on the bicycle in any case."
        ),
    ] = MODELS[0],
    config: Annotated[Path | None, typer.Option(help="Shield settings, TOML (see `shield config`).")] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            help="Write the episodes here (.csv or .parquet), and beside it the summary"
            " and the comparison, as NAME-summary and NAME-comparison."
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files that exist.")] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where a run with this --output was stopped.")] = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print Markdown tables.")] = False,
    simulator: Annotated[
        str,
        typer.Option(
            help=f"One of {', '.join(SIMULATORS)}. The compiled highway is the same, bit for bit;"
            " auto takes it where it serves."
        ),
    ] = SIMULATORS[0],
) -> None:
    """Drive episodes and print crash rates, returns, speeds, overrides and latencies.

    All rows drive the same seeds. Rates in percent with 95 % intervals, speeds in m/s,
    distances and margins in m, latencies in ms per decision.
    """
    import pandas as pd

    from evaluation.learning.normalised_model import statistics_beside
    from evaluation.running.episodes import run_paired
    from evaluation.running.records import make_variants
    from evaluation.running.store import Store, provenance

    shield_config = None if config is None else ShieldConfig.load(config)
    doors = [each.value for each in Door if each is not Door.ALL] if door is Door.ALL else [door.value]
    settings = _asked_settings(setting, env_id, env_config)
    if resume and output is None:
        raise ConfigError("--resume goes with --output")
    if output is not None:
        _check_output(output, force)
    asked = {
        "settings": {each.name: {"env_id": each.env_id, "config": dict(each.config)} for each in settings},
        "policies": _split(policy),
        "shields": shield,
        "doors": doors,
        "episodes": episodes,
        "seed": seed,
        "algorithm": algorithm,
        "model": model,
        "shield": None if shield_config is None else shield_config.to_toml(),
        "simulator": simulator,
    }
    for name in _split(policy):
        if name.endswith(".zip") and (statistics := statistics_beside(Path(name))):
            _err.print(f"{name}: observations are normalised by {statistics.name} beside it")
    store = Store(output, asked, resume)
    try:
        parts = [
            run_paired(
                each,
                driver,
                make_variants(_shields(shield, each.road), doors, shield_config),
                range(seed, seed + episodes),
                jobs=jobs,
                algorithm=algorithm,
                model=model,
                simulator=simulator,
                progress=True,
                store=store,
            )
            for each in settings
            for driver in _split(policy)
        ]
    except KeyboardInterrupt:
        if store.rows:
            _report(pd.DataFrame(store.rows), None, markdown)
        kept = "" if output is None else "; --resume goes on from there"
        _err.print(f"stopped after {len(store.rows)} episodes{kept}")
        raise typer.Exit(130) from None
    _report(pd.concat(parts, ignore_index=True), output, markdown, provenance(asked))
    store.finish()


add_certifying(app)


@app.command()
def demo(
    episodes: Annotated[int, typer.Option(min=1, help="Episodes for each row.")] = 20,
    output: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs", "demo"),
    jobs: Annotated[int, typer.Option(help="Processes; -1 for one per core.")] = -1,
) -> None:
    """Drive the bundled PPO with and without the shield, and film overrides.

    Takes less than two minutes on two cores. Writes the episodes, their summary, and
    override.gif: the bundled agent that has learned to crash, behind the shield.
    """
    from evaluation.report.video import film_override
    from evaluation.running.episodes import run_paired
    from evaluation.running.records import make_variants

    frame = run_paired(
        DEMO_SETTING,
        DEMO_POLICY,
        make_variants(["none", "full"], ["env"]),
        range(EVALUATION_SEED, EVALUATION_SEED + episodes),
        jobs=jobs,
        progress=True,
    )
    _report(frame, output / "episodes.parquet", markdown=False)
    film = film_override(output / "override.gif")
    _out.print(f"wrote {film.path} (seed {film.seed}, {film.overrides} decisions overridden)")


@app.command("cem-demo")
def cem_demo_command(
    output: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs", "cem-demo"),
) -> None:
    """Learn to park: collect, fit, plan, and film it.

    Takes less than two minutes on one core. Writes parking.gif and error.png.
    """
    from evaluation.commands.cem_demo import cem_demo

    for path in cem_demo(output, _out.print):
        _out.print(f"wrote {path}")


@app.command()
def film(
    output: Annotated[Path, typer.Argument(help="The .gif to write.")] = Path("runs", "film.gif"),
    setting: Annotated[str, typer.Option(help="Named environment (see `shield settings`).")] = DEMO_SETTING,
    policy: Annotated[str, typer.Option(help="A policy by name, or an SB3 .zip.")] = DEMO_POLICY,
    seed: Annotated[
        int, typer.Option(min=0, help=f"Where the search for an override begins, below {FIRST_EVALUATION_SEED}.")
    ] = 0,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file that exists.")] = False,
) -> None:
    """Film a policy behind the shield, around one of its overrides."""
    from evaluation.report.video import film_override

    if output.exists() and not force:
        raise ConfigError(f"{output} exists already; --force overwrites it")
    made = film_override(output, setting, policy, seed)
    _out.print(f"wrote {made.path} (seed {made.seed}, {made.overrides} decisions overridden)")


@app.command()
def picture(
    output: Annotated[Path, typer.Argument(help="The .png to write.")] = Path("docs", "images", "override.png"),
) -> None:
    """Write a still of an override, as in the README."""
    from evaluation.report.video import still_of_override

    _out.print(f"wrote {still_of_override(output)}")


@app.command()
def plot(
    episodes: Annotated[Path, typer.Argument(help="What `shield evaluate --output` wrote, .csv or .parquet.")],
    output: Annotated[
        Path | None, typer.Option(help="The .png, .svg or .pdf to write; by default beside the episodes, as .png.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file that exists.")] = False,
) -> None:
    """Plot crash rates, returns, overrides by reason and smallest gaps."""
    from evaluation.report.plots import plot_episodes
    from evaluation.report.table import read_episodes

    path = output or episodes.with_suffix(".png")
    if path.exists() and not force:
        raise ConfigError(f"{path} exists already; --force overwrites it")
    _out.print(f"wrote {plot_episodes(read_episodes(episodes), path)}")


@app.command()
def figures(
    output: Annotated[Path, typer.Option(help="Folder for the pictures.")] = Path("docs", "images"),
) -> None:
    """Draw the figures of how the shield decides."""
    from evaluation.report.figures import write_figures

    for path in write_figures(output):
        _out.print(f"wrote {path}")


@app.command("settings")
def settings_command() -> None:
    """List the named environments."""
    from evaluation.settings import SETTINGS

    table = Table("setting", "environment", "")
    for setting in SETTINGS.values():
        table.add_row(setting.name, setting.env_id, setting.description)
    _out.print(table)


@app.command("config")
def config_command(
    profile: Annotated[str, typer.Option(help=f"One of {', '.join(PROFILES)}.")] = "default",
) -> None:
    """Print the shield's settings as TOML: the default ones, those for meta-actions alone, or
    those that simulate the traffic."""
    typer.echo(ShieldConfig.profile(profile).to_toml(), nl=False)


def _asked_settings(names: list[str] | None, env_id: str | None, config: Path | None) -> list[Setting]:
    """The settings of a comparison: named, or an environment of the user's."""
    from evaluation.settings import get_setting, setting_of

    if env_id is None:
        if config is not None:
            raise ConfigError("--env-config goes with --env-id")
        return [get_setting(name) for name in _split(names or [DEMO_SETTING])]
    if names is not None:
        raise ConfigError("give either --setting or --env-id")
    setting = setting_of(env_id, config)
    setting.make().close()
    return [setting]


def _shields(asked: list[str] | None, road: bool) -> list[str]:
    """The shield modes that were asked for, or those that a setting is driven with otherwise."""
    if asked is not None:
        return _split(asked)
    return ["none", "full"] if road else ["none"]


def _split(values: list[str]) -> list[str]:
    """Repeated options and comma lists as one list, each value once."""
    names = [name.strip() for value in values for name in value.split(",") if name.strip()]
    return list(dict.fromkeys(names))


def _check_output(path: Path, force: bool) -> None:
    """Refuse what cannot be written before hours of driving, not after."""
    from evaluation.report.table import TABLE_ENDINGS

    if path.suffix not in TABLE_ENDINGS:
        raise ConfigError(f"--output {path.name!r} must end in {' or '.join(TABLE_ENDINGS)}")
    if path.exists() and not force:
        raise ConfigError(f"--output {path} exists already; --force overwrites it")
    if force:
        path.with_name(path.name + ".episodes").unlink(missing_ok=True)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise ConfigError(f"--output {path} cannot be written: {error.strerror}") from None


def _report(episodes: pd.DataFrame, output: Path | None, markdown: bool, made: dict[str, Any] | None = None) -> None:
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


def main() -> None:
    """Entry point: errors of the project become one line and exit code 2."""
    try:
        app()
    except ShieldError as error:
        _err.print(f"Error: {error}", style="red", markup=False, soft_wrap=True)
        sys.exit(2)


if __name__ == "__main__":
    main()
