"""The commands `shield monitor train` and `grade`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from evaluation.commands.shared_options import split
from shield.errors import ConfigError

__all__ = ["monitor_app"]

monitor_app = typer.Typer(
    help="Learn a safety monitor of bird's-eye frames, and grade it by the simulator.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
_out, _err = Console(), Console(stderr=True, highlight=False)
_GRADING_SEED = 100_000
"""First seed of the graded episodes; training and calibration use seeds below 10,000."""


@monitor_app.command()
def train(
    setting: Annotated[str, typer.Option(help="A straight highway with meta-actions (see `shield settings`).")] = (
        "highway-fast"
    ),
    rounds: Annotated[int, typer.Option(help="Rounds; from the second on, behind the monitor of the last.")] = 4,
    environments: Annotated[int, typer.Option(min=1, help="Environments of a round.")] = 96,
    steps: Annotated[int, typer.Option(min=1, help="Decisions in each of them.")] = 300,
    calibration: Annotated[int, typer.Option(min=1, help="Calibration episodes.")] = 300,
    miss: Annotated[float, typer.Option(help="Share of the unsafe actions that the threshold may miss.")] = 0.003,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the initial weights and the order of the states.")] = 0,
    output: Annotated[Path, typer.Option(help="Folder of the monitor.")] = Path("runs", "monitor"),
) -> None:
    """Train a monitor on labels of simulated traffic, calibrate it, and write it."""
    from dynamics.world_model.monitor import MonitorConfig, save_monitor
    from evaluation.running.manifest import commit
    from evaluation.settings import get_setting
    from evaluation.threads import one_thread
    from evaluation.training.monitor import MonitorTraining
    from evaluation.training.monitor_rounds import MonitorRounds, train_monitor

    chosen = get_setting(setting)
    options = MonitorRounds(
        env_id=chosen.env_id,
        config=chosen.configured,
        rounds=rounds,
        environments=environments,
        steps=steps,
        calibration=calibration,
        miss=miss,
        training=MonitorTraining(seed=seed),
    )
    with one_thread():
        monitor, notes = train_monitor(options, MonitorConfig(seed=seed), _err.print)
    folder = save_monitor(monitor, output, {**notes, "setting": setting, "commit": commit()})
    _out.print(f"wrote {folder}", soft_wrap=True)


@monitor_app.command(name="grade")
def grade_command(
    folder: Annotated[Path, typer.Argument(help="A folder that `shield monitor train` wrote.")],
    setting: Annotated[str, typer.Option(help="The highway to grade on, of the training or another.")] = "highway-fast",
    drivers: Annotated[str, typer.Option(help="random, faster, idle, slower, mixed; comma-separated.")] = (
        "random,faster,slower"
    ),
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of each driver, bare and behind the monitor.")] = 250,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first episode.")] = _GRADING_SEED,
    output: Annotated[Path | None, typer.Option(help="CSV file to write.")] = None,
) -> None:
    """Drive with the simulator's labels: crashes bare and behind the monitor, false passes and false alarms."""
    from dynamics.world_model.monitor import load_monitor
    from evaluation.settings import get_setting
    from evaluation.threads import one_thread
    from evaluation.training.monitor_grading import grade_drivers

    names = split([drivers])
    if not names:
        raise ConfigError("--drivers names at least one of random, faster, idle, slower, mixed")
    chosen, monitor = get_setting(setting), load_monitor(folder)
    with one_thread():
        table = grade_drivers(
            monitor, names, range(seed, seed + episodes), chosen.env_id, chosen.configured, _err.print
        )
    if output is not None:
        output.parent.mkdir(parents=True, exist_ok=True)
        table.to_csv(output, index=False)
    _out.print(table.T.to_string(header=False, float_format=lambda x: f"{x:.4f}"), soft_wrap=True)
