"""The commands about rare events: certify, falsify, rare, attack."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from evaluation.commands.falsifying import FalsifyOptions, falsify_command
from evaluation.commands.names import DEMO_SETTING
from evaluation.commands.options_command import one_option_a_field
from evaluation.commands.shared_options import (
    EnvConfig,
    EnvId,
    NamedSetting,
    check_jobs,
    check_modes,
    read_setting,
    split,
)
from evaluation.names import ANY, SIMULATORS, check_name, check_policy, check_sensor
from evaluation.settings import get_setting
from shield.config import ShieldConfig

if TYPE_CHECKING:
    import pandas as pd

    from evaluation.running.driver import DriverSpec

__all__ = ["add_certifying"]

_out, _err = Console(), Console(stderr=True, highlight=False)


@dataclass(frozen=True)
class CertifyOptions:
    """The options of `shield certify`."""

    output: Annotated[Path, typer.Argument(help="Folder for the episodes; a stopped run in it is continued.")]
    setting: NamedSetting = None
    env_id: EnvId = None
    env_config: EnvConfig = None
    policy: Annotated[str, typer.Option(help="Name of a policy, or an SB3 .zip.")] = "faster"
    episodes: Annotated[int, typer.Option(min=1, help="Number of episodes, all shielded.")] = 10_000
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first episode; the others follow.")] = 1_000_000
    jobs: Annotated[int, typer.Option(help="Processes; -1 for one per core.")] = -1
    config: Annotated[Path | None, typer.Option(help="Shield settings, TOML (see `shield config`).")] = None
    simulator: Annotated[str, typer.Option(help=f"One of {', '.join(SIMULATORS)}.")] = SIMULATORS[0]


def certify_command(options: CertifyOptions) -> None:
    """Drive very many shielded episodes, and write a bound on their crash rate.

    Parts of 1,000 episodes are stored as they finish. The same command continues a stopped
    run, and one with more --episodes extends a finished one. Writes episodes.parquet and
    certificate.md: crashes with their seeds, a Clopper-Pearson bound on their rate, the
    least clearance, violations by the traffic, fallbacks.
    """
    check_policy(options.policy)
    check_jobs(options.jobs)
    check_name("simulator", options.simulator, SIMULATORS)
    given = None if options.config is None else ShieldConfig.named(options.config)
    where = read_setting(options.setting, options.env_id, options.env_config)
    from rich.progress import Progress

    from evaluation.report.table import write_table
    from evaluation.running.certify import CertifyRun, certify, page
    from evaluation.running.records import config_on

    run = CertifyRun(where, options.policy, options.episodes, options.seed, config_on(where, given), options.simulator)
    with Progress(console=_err, disable=not _err.is_terminal, transient=True) as bar:
        task = bar.add_task(f"{options.policy} on {where.name}", total=len(run.parts()))

        def report_part(part: pd.DataFrame) -> None:
            bar.advance(task)
            if not _err.is_terminal or part["crashed"].any():
                _err.print(f"seeds {part['seed'].min()} to {part['seed'].max()}: {part['crashed'].sum()} crashed")

        found = certify(run, options.output, options.jobs, report_part)
    write_table(found, options.output / "episodes.parquet")
    text = page(found)
    (options.output / "certificate.md").write_text(text, encoding="utf-8")
    typer.echo(text)


@dataclass(frozen=True)
class RareOptions:
    """The options of `shield rare`."""

    setting: Annotated[str, typer.Option(help="Named environment (see `shield settings`).")] = DEMO_SETTING
    policy: Annotated[str, typer.Option(help="Name of a policy, an SB3 .zip, or `any` (exact sensor).")] = "faster"
    samples: Annotated[
        int | None, typer.Option(min=2, help="Episodes of a level; by default 2,000, and 200 with a noisy sensor.")
    ] = None
    seed: Annotated[int, typer.Option(min=0, help="Seed of the estimate.")] = 0
    config: Annotated[Path | None, typer.Option(help="Shield settings, TOML (see `shield config`).")] = None
    sensor: Annotated[str, typer.Option(help="Sensor of the policy, as in `shield evaluate`.")] = "exact"
    perception: Annotated[
        str, typer.Option(help="Source of the shield's scenes with a noisy sensor: simulator or observation.")
    ] = "observation"
    jobs: Annotated[int, typer.Option(help="Processes, with a noisy sensor; -1 for one per core.")] = -1


def rare_command(options: RareOptions) -> None:
    """Estimate how often an episode ends in a crash, without counting.

    The estimate comes from subset simulation over the scenes. An event that happens once in
    10,000 episodes takes some 8,000 of them; counting takes 250,000 for the same error. With a
    noisy sensor every step is random, and the estimate comes from splitting episodes near a crash.
    """
    if options.policy != ANY:
        check_policy(options.policy)
    check_jobs(options.jobs)
    check_sensor(options.sensor)
    check_modes([], [options.perception])
    where = get_setting(options.setting)
    import numpy as np

    from evaluation.falsification.falsify import crash_probability

    shield_config = ShieldConfig() if options.config is None else ShieldConfig.load(options.config)
    if options.sensor != "exact":
        from evaluation.running.driver import DriverSpec
        from evaluation.running.records import ShieldVariant

        variant = (
            ShieldVariant() if shield_config.mode == "none" else ShieldVariant("env", shield_config, options.perception)
        )
        _rare_through(
            DriverSpec(where, options.policy, variant, sensor=options.sensor),
            options.samples or 200,
            options.seed,
            options.jobs,
        )
        return
    found = crash_probability(where, options.policy, shield_config, options.samples or 2_000, options.seed)
    table = Table("level", "time to collision [s]", "probability", "moves taken")
    for k, level in enumerate(found.levels):
        moves = "" if np.isnan(level.accepted) else f"{level.accepted:.0%}"
        table.add_row(str(k + 1), f"{level.bound:.3f}", f"{level.probability:.3f}", moves)
    _out.print(table)
    _print_probability(found.probability, found.variation, found.evaluations)


def _rare_through(spec: DriverSpec, paths: int, seed: int, jobs: int) -> None:
    """Print the estimate with a noisy sensor, and its rounds."""
    from evaluation.falsification.sensor_noise_crashes import crash_probability_through

    found = crash_probability_through(spec, paths, seed=seed, jobs=jobs)
    table = Table("round", "time to collision [s]", "dropped")
    for k, (level, dropped) in enumerate(zip(found.levels, found.dropped, strict=True)):
        table.add_row(str(k + 1), f"{-level:.3f}", str(dropped))
    _out.print(table)
    _print_probability(found.probability, found.variation, found.evaluations)


def _print_probability(probability: float, variation: float, evaluations: int) -> None:
    """Print an estimate. An event that was not reached has no coefficient of variation."""
    said = f"coefficient of variation at least {variation:.0%}"
    if probability == 0:
        said = "the event was not reached; raise --samples"
    _out.print(f"probability {probability:.2e} ({said}) from {evaluations} episodes")


def attack_command(
    setting: Annotated[str, typer.Option(help="Named environments on road networks, with commas between.")] = (
        "roundabout,merge,exit,two-way,u-turn,intersection"
    ),
    drivers: Annotated[
        str,
        typer.Option(help="wild: random throttle and steering; bold: worst-case compliant; mixed: both."),
    ] = "mixed",
    vehicles: Annotated[int, typer.Option(min=1, help="Number of vehicles that the drivers replace.")] = 8,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of each environment.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first episode; the others follow.")] = 0,
    jobs: Annotated[int, typer.Option(help="Processes; -1 for one per core.")] = -1,
    config: Annotated[Path | None, typer.Option(help="Shield settings, TOML; by default the road's own.")] = None,
) -> None:
    """Drive adversarial traffic against the certificate on road networks, in highway-env itself.

    Every motion of the traffic has to be a recorded violation, or cause no harm. Otherwise the
    command prints the seeds and exits with status 1.
    """
    check_jobs(jobs)
    settings = [get_setting(name) for name in split([setting])]
    from collections import Counter

    from evaluation.falsification.network_attack import attack_many

    shield_config = None if config is None else ShieldConfig.load(config)
    table = Table("environment", "drivers", "episodes", "frames", "crashes", "rules broken", "unforeseen")
    holes = False
    for each in settings:
        found = attack_many(each, drivers, episodes, seed, vehicles, jobs, shield_config)
        rules: Counter[str] = sum((Counter(one.by_rule) for one in found), Counter())
        seeds = [one.seed for one in found if one.unforeseen]
        holes = holes or bool(seeds)
        numbers = len(found), sum(one.frames for one in found), sum(one.crashed for one in found)
        broken = ", ".join(f"{rule} {count}" for rule, count in rules.most_common())
        table.add_row(each.name, drivers, *map(str, numbers), broken, ", ".join(map(str, seeds)) or "0")
    _out.print(table)
    if holes:
        raise typer.Exit(1)


def add_certifying(app: typer.Typer) -> None:
    """Add these commands to the application."""
    app.command("certify")(one_option_a_field(certify_command, CertifyOptions))
    app.command("falsify")(one_option_a_field(falsify_command, FalsifyOptions))
    app.command("rare")(one_option_a_field(rare_command, RareOptions))
    app.command("attack")(attack_command)
