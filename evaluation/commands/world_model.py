"""The commands `shield world-model train`, `evaluate` and `dream`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from evaluation.commands.options_command import one_option_a_field
from evaluation.commands.reporting import check_writable
from evaluation.commands.shared_options import split
from evaluation.names import FIRST_EVALUATION_SEED, TABLE_ENDINGS, check_name
from shield.config import PROFILES
from shield.errors import ConfigError

if TYPE_CHECKING:
    from evaluation.training.latent.train import Progress

__all__ = ["world_model_app"]

world_model_app = typer.Typer(
    help="Drivers that learn from bird's-eye frames in a world model.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
_out, _err = Console(), Console(stderr=True, highlight=False)

_ALGORITHMS = ("latent", "cnn-ppo")
_OF_LATENT = (
    *("updates", "latent", "objective", "size", "override_penalty", "rate", "validate_every", "horizon", "start"),
)
"""Options of a latent driver only."""
_FRESH_SEED = 3_000_000


@dataclass(frozen=True)
class TrainOptions:
    """The options of `shield world-model train`."""

    output: Annotated[Path, typer.Option(help="Folder of the checkpoint; for cnn-ppo a .zip file.")] = Path(
        "runs", "world-model"
    )
    algorithm: Annotated[str, typer.Option(help=f"{' or '.join(_ALGORITHMS)} (the baseline).")] = "latent"
    setting: Annotated[str, typer.Option(help="A straight highway with meta-actions.")] = "highway-fast"
    shield: Annotated[str, typer.Option(help=f"Learn inside the shield: {', '.join(PROFILES)}; or none.")] = "none"
    seed: Annotated[int, typer.Option(min=0, help="Training seed, below 90.")] = 0
    discount: Annotated[float | None, typer.Option(help="Discount of each decision; 0.95 by default.")] = None
    updates: Annotated[int | None, typer.Option(help="Updates; 2,600 by default. Not of cnn-ppo.")] = None
    latent: Annotated[str | None, typer.Option(help="simnorm (default) or categorical. Not of cnn-ppo.")] = None
    objective: Annotated[
        str | None, typer.Option(help="joint-embedding (default) or reconstruction. Not of cnn-ppo.")
    ] = None
    size: Annotated[str | None, typer.Option(help="small (default) or large. Not of cnn-ppo.")] = None
    override_penalty: Annotated[
        float | None, typer.Option(help="Deduction for each overridden decision. Not of cnn-ppo.")
    ] = None
    rate: Annotated[float | None, typer.Option(help="Learning rate; 0.001 by default. Not of cnn-ppo.")] = None
    validate_every: Annotated[int | None, typer.Option(help="Updates between two validations. Not of cnn-ppo.")] = None
    horizon: Annotated[int | None, typer.Option(help="Imagined decisions; 4 by default. Not of cnn-ppo.")] = None
    start: Annotated[Path | None, typer.Option(help="Folder of a driver to continue from. Not of cnn-ppo.")] = None
    cpu_seconds: Annotated[float | None, typer.Option(help="CPU time of cnn-ppo [s]; 1,200 by default.")] = None


def train(options: TrainOptions) -> None:
    """Train a driver on frames on one core, and write its best checkpoint.

    Checkpoints are compared on seeds of their own, 9,000 to 9,999. Training has lower ones.
    """
    check_name("algorithm", options.algorithm, _ALGORITHMS)
    latent = options.algorithm == "latent"
    networks = (
        "updates",
        "latent",
        "objective",
        "size",
        "override_penalty",
        "rate",
        "validate_every",
        "horizon",
        "start",
    )
    others = ("cpu_seconds",) if latent else networks
    wrong = [f"--{name.replace('_', '-')}" for name in others if getattr(options, name) is not None]
    if wrong:
        raise ConfigError(f"{options.algorithm} has no {', '.join(wrong)}")
    own = (*_OF_LATENT, "discount") if latent else ("cpu_seconds", "discount")
    given: dict[str, Any] = {name: getattr(options, name) for name in own if getattr(options, name) is not None}
    given |= {name: getattr(options, name) for name in ("output", "setting", "shield", "seed")}
    check_writable(options.output)
    if latent:
        from evaluation.training.latent.options import LatentTrainingOptions
        from evaluation.training.latent.train import train_latent

        _out.print(f"wrote {train_latent(LatentTrainingOptions(**given), _tell).path}")
        return
    from evaluation.training.latent.frame_ppo import FramePPOOptions, train_frame_ppo

    train_frame_ppo(FramePPOOptions(**{"cpu_seconds": 1200.0, **given}), _tell)
    _out.print(f"wrote {options.output.with_suffix('.zip')}")


world_model_app.command("train")(one_option_a_field(train, TrainOptions))


def _tell(progress: Progress) -> None:
    """Print a line for a validation."""
    _out.print(
        f"update {progress.update}, {progress.steps} decisions, {progress.seconds:.0f} CPU s: return "
        f"{progress.returned:.2f}, crashes {100 * progress.crash:.1f} %, {progress.speed:.1f} m/s",
        highlight=False,
    )


@world_model_app.command()
def evaluate(
    driver: Annotated[
        list[str] | None, typer.Argument(help="Folders of `train`, SB3 .zip files on frames; none for baselines only.")
    ] = None,
    setting: Annotated[str, typer.Option(help="A straight highway with meta-actions.")] = "highway-fast",
    shield: Annotated[list[str], typer.Option(help=f"none, {', '.join(PROFILES)} (repeatable, or a comma list).")] = [  # noqa: B006
        "none,default"
    ],
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of each row.")] = 512,
    seed: Annotated[int, typer.Option(min=FIRST_EVALUATION_SEED, help="First seed of the episodes.")] = _FRESH_SEED,
    baselines: Annotated[bool, typer.Option(help="Whether the table has the baselines.")] = True,
    lookahead: Annotated[int, typer.Option(min=0, help="Imagined decisions by which latent drivers compare.")] = 0,
    imagination: Annotated[
        int, typer.Option(min=0, help="Episodes in which imagined occupancy is measured; 0 for none.")
    ] = 0,
    output: Annotated[Path | None, typer.Option(help="Write the table (.csv or .parquet).")] = None,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print a Markdown table.")] = False,
) -> None:
    """Drive fresh seeds with drivers and baselines, bare and behind the shield.

    Baselines: uniform actions, always SLOWER, always FASTER, and a car that stops.
    """
    if output is not None:
        if output.suffix not in TABLE_ENDINGS:
            raise ConfigError(f"--output {output.name!r} must end in {' or '.join(TABLE_ENDINGS)}")
        check_writable(output)
    from evaluation.report.table import write_table
    from evaluation.running.frame_table import BASELINES, frame_table
    from evaluation.settings import get_setting

    drivers = [*(BASELINES if baselines else ()), *(driver or [])]
    if not drivers:
        raise ConfigError("--no-baselines leaves no driver: name one")
    where, seeds = get_setting(setting), range(seed, seed + episodes)
    with _err.status("driving") as status:
        table = frame_table(drivers, where, seeds, split(shield), lookahead, status.update)
    _print_table(table, markdown)
    if output is not None:
        write_table(table, output)
        _out.print(f"wrote {output}")
    if imagination:
        _print_imagination(driver or [], where, range(seed, seed + imagination))


def _print_table(table: Any, markdown: bool) -> None:
    heading = ["driver", "shield", "episodes", "crashes %", "return", "m/s", "overridden %"]
    rows = [
        [
            row["driver"],
            row["shield"],
            str(row["episodes"]),
            f"{100 * row['crash']:.1f} [{100 * row['crash_low']:.1f}, {100 * row['crash_high']:.1f}]",
            f"{row['return']:.2f} [{row['return_low']:.2f}, {row['return_high']:.2f}]",
            f"{row['speed']:.1f}",
            "" if row["shield"] == "none" else f"{100 * row['overridden']:.1f}",
        ]
        for row in table.to_dict("records")
    ]
    if markdown:
        lines = [heading, [":--", ":--", *["--:"] * (len(heading) - 2)], *rows]
        typer.echo("\n".join("| " + " | ".join(line) + " |" for line in lines))
        return
    shown = Table(*heading)
    for row in rows:
        shown.add_row(*row)
    _out.print(shown)


def _print_imagination(drivers: list[str], setting: Any, seeds: range) -> None:
    """Print the quality of imagined occupancy of each latent driver."""
    from evaluation.running.dreams import imagination_quality
    from evaluation.running.frame_table import load_frame_driver
    from mpc.latent.driver import LatentDriver

    shown = Table("driver", "decisions ahead", "IoU imagined", "constant velocity", "mean map")
    for name in drivers:
        driver = load_frame_driver(name)
        if not isinstance(driver, LatentDriver):
            continue
        for each in imagination_quality(driver, setting, seeds):
            numbers = (each.imagined, each.constant_velocity, each.mean_map)
            shown.add_row(Path(name).stem, str(each.ahead), *(f"{number:.3f}" for number in numbers))
    _out.print(shown)


@world_model_app.command("dream")
def dream_command(
    driver: Annotated[Path, typer.Argument(help="Folder of `train`.")],
    output: Annotated[Path, typer.Option(help="The .png to write: a strip.")] = Path("runs", "dream.png"),
    film: Annotated[Path | None, typer.Option(help="The .gif to write.")] = None,
    setting: Annotated[str, typer.Option(help="A straight highway with meta-actions.")] = "highway-fast",
    seed: Annotated[int, typer.Option(min=0, help="Seed of the episode.")] = _FRESH_SEED,
    context: Annotated[int, typer.Option(min=1, help="Frames that the model sees.")] = 5,
    steps: Annotated[int, typer.Option(min=1, help="Decisions that it imagines.")] = 10,
) -> None:
    """Draw real frames of an episode above what the world model decodes, and then imagines.

    The imagined decisions have the actions that the driver took in the episode.
    """
    from evaluation.report.dream_picture import draw_dream, dream_path, film_dream
    from evaluation.running.dreams import dream
    from evaluation.settings import get_setting
    from mpc.latent.files import load_driver

    dream_path(output, ".png")
    check_writable(output)
    if film is not None:
        check_writable(dream_path(film, ".gif"))
    found = dream(load_driver(driver), get_setting(setting), seed, context, steps)
    _out.print(f"wrote {draw_dream(found, output)}")
    if film is not None:
        _out.print(f"wrote {film_dream(found, film)}")
