"""The commands `shield dynamics fit`, `evaluate`, `plot`, `export` and `import`."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from evaluation.commands.options_command import one_option_a_field
from shield.errors import ConfigError

if TYPE_CHECKING:
    from evaluation.measuring.dynamics_study import TimedRound

__all__ = ["dynamics_app"]

dynamics_app = typer.Typer(
    help="Learn models of the dynamics from driving, and measure them.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
_out, _err = Console(), Console(stderr=True)

DATA_FILE = "transitions.npz"
"""Name of the data file that `fit` writes beside a model."""

_ALL: list[str] = []


@dataclass(frozen=True)
class FitOptions:
    """The options of `shield dynamics fit`."""

    env: Annotated[str | None, typer.Option(help="Environment to learn in; parking-v0 without --setting.")] = None
    setting: Annotated[
        str | None,
        typer.Option(help="Learn throttle and steering at highway speeds in this setting, for --model of `evaluate`."),
    ] = None
    variant: Annotated[str | None, typer.Option(help="Training variant (see `evaluate`); rounds by default.")] = None
    transitions: Annotated[int | None, typer.Option(help="Transitions with random actions.")] = None
    rounds: Annotated[int | None, typer.Option(help="Rounds of driving by a planner with the model so far.")] = None
    per_round: Annotated[int | None, typer.Option(help="Transitions in each of these rounds.")] = None
    members: Annotated[int | None, typer.Option(help="Members of the ensemble.")] = None
    seed: Annotated[int, typer.Option(min=0, help="Seed of all random numbers.")] = 0
    tensorboard: Annotated[str | None, typer.Option(help="Folder for TensorBoard's event files.")] = None
    output: Annotated[Path, typer.Option(help="Folder of the model and its data.")] = Path("runs", "dynamics")


def fit(options: FitOptions) -> None:
    """Collect driving, fit a model, and write it.

    Prints for each round the open-loop position error [m] after 1 and 15 decisions, on held-out
    episodes of all its data, and on the round's new driving before the fit to it.
    """
    from dynamics.learned.models.files import save_model
    from dynamics.learned.training.variants import variant as named
    from evaluation.measuring.dynamics_study import learn

    given = {"transitions": options.transitions, "rounds": options.rounds, "per_round": options.per_round}
    if options.setting is not None:
        others = {name: getattr(options, name) for name in ("env", "variant", "members", "tensorboard")} | given
        wrong = [name for name, value in others.items() if value is not None and name != "transitions"]
        if wrong:
            raise ConfigError(f"--setting goes with --transitions, --seed and --output; not with {', '.join(wrong)}")
        _fit_driving(options.setting, options.seed, options.transitions, options.output)
        return
    env, variant = options.env or "parking-v0", options.variant or "rounds"
    setup = named(variant).seeded(options.seed)
    setup = replace(setup, data=replace(setup.data, **{k: v for k, v in given.items() if v is not None}))
    if options.members is not None:
        setup = replace(setup, model=replace(setup.model, members=options.members))
    seconds, cpu = 0.0, process_time()
    table = Table("round", "data", "driving s", "fitting s", "held out 1", "15", "new 1", "15")
    last: TimedRound | None = None
    for timed in learn(setup, env, progress=sys.stderr.isatty(), tensorboard=options.tensorboard):
        table.add_row(*_row(timed, last))
        last, seconds = timed, seconds + timed.driving + timed.fitting
    _out.print(table)
    assert last is not None
    cpu = process_time() - cpu
    notes = {"environment": env, "variant": variant, "seed": options.seed}
    notes |= {"seconds": round(seconds, 1), "cpu": round(cpu, 1)}
    notes |= {"transitions": len(last.round.data), "origin": dict(last.round.data.origin)}
    save_model(last.round.fit.model, options.output, notes)
    last.round.data.save(options.output / DATA_FILE)
    _out.print(f"wrote {options.output} ({seconds:.1f} s, {cpu:.1f} s of it on a core)")


dynamics_app.command("fit")(one_option_a_field(fit, FitOptions))


def _row(timed: TimedRound, last: TimedRound | None) -> list[str]:
    """The cells of a round: counts, times, and open-loop errors [m] on held-out and on new driving."""
    from dynamics.learned.training.open_loop import open_loop
    from evaluation.measuring.dynamics_study import HORIZON

    now = timed.round
    errors = open_loop(now.fit.model, now.fit.held_out, HORIZON).median[[0, -1]].tolist()
    if last is not None:
        new = now.data.take(slice(len(last.round.data), None))
        errors += open_loop(last.round.fit.model, new, HORIZON).median[[0, -1]].tolist()
    counts = [str(now.number), str(len(now.data)), f"{timed.driving:.1f}", f"{timed.fitting:.1f}"]
    return [*counts, *(f"{error:.4f}" for error in errors)]


def _fit_driving(setting: str, seed: int, transitions: int | None, output: Path) -> None:
    """Train the models of a setting, and print their open-loop errors [m] in new driving."""
    from dynamics.learned.models.bicycle import BicycleModel
    from evaluation.running.driving_model import TRANSITIONS, measure, train_driving
    from mpc.mpc_policy import MPCPolicy

    table = Table("model", "data", "core s", "random 1", "15", "15 (95 %)", "mpc 1", "15", "15 (95 %)")
    count = TRANSITIONS if transitions is None else transitions
    for trained in train_driving(setting, seed, output, count, progress=sys.stderr.isatty()):
        frames = trained.frames
        exact = BicycleModel(trained.actuators, 1 / trained.frequency, frames)
        for name, model in ((trained.name, trained.model), ("true bicycle", exact)):
            cells = []
            for policy in (None, MPCPolicy):
                error = measure(model, setting, frames, trained.actuators, policy=policy)
                cells += [*error.median[[0, -1]].tolist(), float(error.quantile(0.95)[-1])]
            about = [str(len(trained.data)), f"{trained.seconds:.1f}"] if model is trained.model else ["0", "0"]
            table.add_row(name, *about, *(f"{cell:.4f}" for cell in cells))
    _out.print(table)
    _out.print(f"wrote {output}")


@dynamics_app.command("export")
def export_command(
    data: Annotated[Path, typer.Argument(help="The file transitions.npz of `fit`.")],
    name: Annotated[str, typer.Argument(help="Id of the Minari data set, such as parking/planner-v0.")],
) -> None:
    """Write transitions as a Minari data set (an extra: pip install -e .[minari])."""
    from dynamics.learned.data.minari import to_minari
    from dynamics.learned.data.transitions import Transitions

    transitions = Transitions.load(data)
    to_minari(transitions, name)
    _out.print(f"wrote {len(transitions)} transitions as {name}")


@dynamics_app.command("import")
def import_command(
    name: Annotated[str, typer.Argument(help="Id of a Minari data set in the local store.")],
    output: Annotated[Path, typer.Argument(help="The .npz to write.")],
    dt: Annotated[float | None, typer.Option(help="Duration of a decision [s], if the data set has none.")] = None,
) -> None:
    """Read a Minari data set with states as observations."""
    from dynamics.learned.data.minari import from_minari

    transitions = from_minari(name, dt)
    _out.print(f"wrote {transitions.save(output)} ({len(transitions)} transitions)")


@dynamics_app.command()
def evaluate(
    variant: Annotated[list[str], typer.Option(help="Train and test these (repeatable, or a comma list).")] = _ALL,
    model: Annotated[list[Path], typer.Option(help="Test these models of `fit` instead (repeatable).")] = [],  # noqa: B006
    env: Annotated[str, typer.Option(help="Environment to learn in.")] = "parking-v0",
    seeds: Annotated[int, typer.Option(min=1, help="Training seeds, from 0 on.")] = 1,
    transitions: Annotated[int, typer.Option(min=50, help="Transitions in each of the two tests.")] = 600,
    output: Annotated[Path | None, typer.Option(help="Write a row for each model and seed (.csv or .parquet).")] = None,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print a Markdown table.")] = False,
) -> None:
    """Print open-loop position errors [m] of models after 1 and 15 decisions (0.2 s and 3 s).

    Prints medians and 95 % quantiles, in new random driving and in a planner's. With several
    seeds it prints the medians of these over the seeds. Without options it trains every variant.
    Seeds that are in --output already are not trained again.
    """
    import pandas as pd

    from evaluation.measuring.dynamics_study import errors
    from evaluation.names import TABLE_ENDINGS
    from evaluation.report.table import write_table

    if output is not None and output.suffix not in TABLE_ENDINGS:
        raise ConfigError(f"--output {output.name!r} must end in {' or '.join(TABLE_ENDINGS)}")
    names = _names(variant, model)
    frame = _done(output, names, transitions) if output is not None and not model else pd.DataFrame()
    todo = [seed for seed in range(seeds) if frame.empty or seed not in set(frame["seed"])]
    for trials in _trials(names, model, env, todo, transitions):
        frame = pd.concat([frame, errors(trials).assign(tested_on=transitions)], ignore_index=True)
        if output is not None:
            write_table(frame, output)
    _print_errors(frame[frame["seed"] < seeds], markdown)
    if output is not None:
        _out.print(f"wrote {output}")


@dynamics_app.command()
def plot(
    output: Annotated[Path, typer.Argument(help="The .png, .svg or .pdf to write.")],
    variant: Annotated[list[str], typer.Option(help="Train and test these (repeatable, or a comma list).")] = _ALL,
    model: Annotated[list[Path], typer.Option(help="Test these models of `fit` instead (repeatable).")] = [],  # noqa: B006
    env: Annotated[str, typer.Option(help="Environment to learn in.")] = "parking-v0",
    seeds: Annotated[int, typer.Option(min=1, help="Training seeds, from 0 on.")] = 1,
    transitions: Annotated[int, typer.Option(min=50, help="Transitions in each of the two tests.")] = 600,
) -> None:
    """Draw the open-loop position error against the horizon."""
    from evaluation.report.error_curves import plot_errors
    from evaluation.report.plots import plot_path

    plot_path(output)
    trials = [each for part in _trials(_names(variant, model), model, env, range(seeds), transitions) for each in part]
    _out.print(f"wrote {plot_errors(trials, output)}")


def _names(variants: list[str], models: list[Path]) -> list[str]:
    """The selected variants; all of them without a selection."""
    from dynamics.learned.training.variants import VARIANTS, variant

    names = list(dict.fromkeys(name.strip() for value in variants for name in value.split(",") if name.strip()))
    if models and names:
        raise ConfigError("give either --variant or --model")
    for name in names:
        variant(name)
    return names or list(VARIANTS)


def _done(output: Path, names: list[str], transitions: int) -> Any:
    """Rows of finished seeds of an earlier run of the same study; raises `ConfigError` for another file."""
    import pandas as pd

    from evaluation.measuring.dynamics_study import TRUTH

    if not output.exists():
        return pd.DataFrame()
    try:
        frame = pd.read_parquet(output) if output.suffix == ".parquet" else pd.read_csv(output)
        rows = [set(group["model"]) for _, group in frame.groupby("seed")]
        same = set(frame["tested_on"]) == {transitions} and all(row == {*names, TRUTH} for row in rows)
    except (KeyError, ValueError, OSError) as error:
        raise ConfigError(f"{output} is there and is no table of this command; name another file") from error
    if not same:
        raise ConfigError(f"{output} has other models or tests than were asked for; name another file")
    return frame


def _trials(names: list[str], models: list[Path], env: str, seeds: Iterable[int], transitions: int) -> Iterator[Any]:
    """Results of stored models, or of each seed."""
    from evaluation.measuring.dynamics_study import stored, study

    def say(line: str) -> None:
        if sys.stderr.isatty():
            _err.print(line, highlight=False)

    if models:
        yield stored({str(path): path for path in models}, DATA_FILE, env, transitions)
    else:
        yield from study(names, seeds, env, transitions, say)


def _print_errors(frame: Any, markdown: bool) -> None:
    numbers = frame.drop(columns="seed").groupby("model", sort=False).median()
    heading = ["model", "data", "fit s"]
    columns = ["random_1", "random_15", "random_15_p95", "on_policy_1", "on_policy_15", "on_policy_15_p95"]
    titles = ["random 1", "15", "15 (95 %)", "planner 1", "15", "15 (95 %)"]
    rows = [
        [str(name), f"{row['transitions']:.0f}", f"{row['fit_seconds']:.1f}", *(f"{row[c]:.3f}" for c in columns)]
        for name, row in numbers.iterrows()
    ]
    if markdown:
        lines = [[*heading, *titles], [":--", *["--:"] * (len(heading) + len(titles) - 1)], *rows]
        typer.echo("\n".join("| " + " | ".join(line) + " |" for line in lines))
        return
    table = Table(*heading, *titles)
    for row in rows:
        table.add_row(*row)
    _out.print(table)
