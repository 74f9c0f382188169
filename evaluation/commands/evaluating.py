"""The commands that drive and compare episodes: evaluate, episodes and merge."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from evaluation.commands.names import DEMO_POLICY, DEMO_SETTING, EVALUATION_SEED
from evaluation.commands.options_command import one_option_a_field
from evaluation.commands.reporting import TableFormat, check_output, check_steps_path, report
from evaluation.commands.shared_options import (
    EnvConfig,
    EnvId,
    check_jobs,
    check_modes,
    lengths,
    read_policies,
    read_settings,
    shard_of,
    split,
)
from evaluation.learning.algorithms import ALGORITHMS, algorithm_named
from evaluation.names import (
    BASELINES,
    CHANNEL_NAMES,
    ENGINES,
    MODELS,
    SENSOR_NAMES,
    SIMULATORS,
    check_name,
    check_sensor,
)
from shield.config import MODES, PERCEPTIONS, ShieldConfig
from shield.errors import ConfigError

if TYPE_CHECKING:
    from evaluation.experiments import Experiment

__all__ = ["add_evaluating"]

_out, _err = Console(), Console(stderr=True, highlight=False)


class Placement(StrEnum):
    """Value of `--placement`."""

    ENV = "env"
    POLICY = "policy"
    ACTIONS = "actions"
    ALL = "all"


@dataclass(frozen=True)
class EvaluateOptions:
    """The options of `shield evaluate`."""

    setting: Annotated[
        list[str] | None,
        typer.Option(help=f"Named environment (repeatable, or a comma list; see `shield settings`) [{DEMO_SETTING}]."),
    ] = None
    env_id: EnvId = None
    env_config: EnvConfig = None
    policy: Annotated[
        list[str] | None,
        typer.Option(
            help=f"{', '.join(BASELINES)}, a reference policy, or an SB3 .zip (repeatable, or a comma list)"
            f" [{DEMO_POLICY}; random with --env-id]."
        ),
    ] = None
    shield: Annotated[
        list[str] | None,
        typer.Option(
            help=f"Shield modes: {', '.join(MODES)} (repeatable, or a comma list)."
            " By default none and full; none alone if the road is not supported."
        ),
    ] = None
    placement: Annotated[
        Placement,
        typer.Option(
            help="env: ShieldedEnv, around the environment; policy: Shield, around the policy;"
            " actions: Shield that chooses actions without supervision of frames; all: each of them."
        ),
    ] = Placement.ENV
    door: Annotated[Placement | None, typer.Option(hidden=True, help="The former name of --placement.")] = None
    perception: Annotated[
        str,
        typer.Option(
            help=f"Source of the shield's scenes: {', '.join(PERCEPTIONS)} (or both). The simulator's true state, or"
            " of the traffic only the policy's observations."
        ),
    ] = PERCEPTIONS[0]
    sensor: Annotated[
        str,
        typer.Option(
            help="Sensors of the policy, and of a shield that reads observations: one or more of"
            f" {', '.join(SENSOR_NAMES)}, metric-S and normalised-S with any standard deviation S. Channels may be"
            " added to the observation, such as"
            f" normalised-0.5+confidence+intent, of {', '.join(CHANNEL_NAMES)}."
        ),
    ] = "exact"
    episodes: Annotated[int, typer.Option(min=1, help="Episodes for each row.")] = 100
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first episode; the others follow.")] = EVALUATION_SEED
    jobs: Annotated[int, typer.Option(help="Processes; -1 for one per core.")] = -1
    algorithm: Annotated[
        str | None,
        typer.Option(help=f"Algorithm of a .zip, if the file does not contain it: {', '.join(sorted(ALGORITHMS))}."),
    ] = None
    model: Annotated[
        str,
        typer.Option(
            help=f"Dynamics model of mpc, and of the predictive filter at placement env: {', '.join(MODELS)},"
            " or a folder of `shield dynamics fit --setting`. The shield always verifies with the bicycle."
        ),
    ] = MODELS[0]
    config: Annotated[
        Path | None,
        typer.Option(help="Shield settings: a TOML file (see `shield config`), simulated, or worst-case."),
    ] = None
    buffer: Annotated[
        list[str] | None,
        typer.Option(
            help="Buffer along the road [m], one row for each value (repeatable, or a comma list); default --config's."
        ),
    ] = None
    output: Annotated[
        Path | None,
        typer.Option(
            help="Write the episodes to this file (.csv or .parquet), and beside it the summary"
            " and the comparison, as NAME-summary and NAME-comparison."
        ),
    ] = None
    force: Annotated[bool, typer.Option("--force", help="Overwrite files that exist.")] = False
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="Continue a stopped run with this --output, or extend a finished one by"
            " episodes, policies, settings or shield modes.",
        ),
    ] = False
    shard: Annotated[
        str | None,
        typer.Option(help="i/n: drive every n-th episode only, from the i-th on; `shield merge` merges the n files."),
    ] = None
    steps: Annotated[
        Path | None,
        typer.Option(help="Write one row for each decision to this file (.parquet).", show_default=False),
    ] = None
    engine: Annotated[
        str,
        typer.Option(help="processes of this machine (see --jobs), or ray: tasks of a Ray cluster (the extra `ray`)."),
    ] = ENGINES[0]
    address: Annotated[
        str | None,
        typer.Option(help="Address of the Ray cluster; auto: the cluster of this machine; local: start one [auto]."),
    ] = None
    markdown: Annotated[bool, typer.Option("--markdown", help="Print Markdown tables.")] = False
    latex: Annotated[bool, typer.Option("--latex", help="Print LaTeX tables, for the package booktabs.")] = False
    simulator: Annotated[
        str,
        typer.Option(
            help=f"One of {', '.join(SIMULATORS)}. The compiled highway is equal to the last bit;"
            " auto takes it where supported."
        ),
    ] = SIMULATORS[0]


def evaluate_command(options: EvaluateOptions) -> None:
    """Drive episodes and print crash rates, returns, speeds, overrides and latencies.

    All rows drive the same seeds. Rates are in percent with 95 % intervals, speeds in m/s,
    distances and margins in m, latencies in ms per decision.
    """
    form = TableFormat.of(options.markdown, options.latex)
    experiment = _experiment(options)
    from evaluation.experiments.experiment import Stopped

    try:
        result = experiment.run()
    except Stopped as stopped:
        if len(stopped.result.episodes):
            report(stopped.result.episodes, form=form)
        kept = "" if options.output is None else "; --resume goes on from there"
        _err.print(f"{stopped}{kept}")
        raise typer.Exit(130) from None
    report(result.episodes, options.output, form, dict(result.made))


def _experiment(options: EvaluateOptions) -> Experiment:
    """The experiment that the options describe. All options are checked before slow imports."""
    placement = options.placement
    if options.door is not None:
        _err.print("--door is deprecated: write --placement")
        placement = options.door
    # The demo's policy reads the demo's observations only, so other environments get a random policy.
    policies = read_policies(options.policy or [DEMO_POLICY if options.env_id is None else "random"])
    modes = None if options.shield is None else split(options.shield)
    sensors, perceptions = split([options.sensor]), split([options.perception])
    check_modes(modes or [], perceptions)
    for each in sensors:
        check_sensor(each)
    check_name("simulator", options.simulator, SIMULATORS)
    if options.algorithm is not None:
        algorithm_named(options.algorithm)
    if not Path(options.model).is_dir():
        check_name("model", options.model, MODELS, ", or the folder of learned models")
    check_jobs(options.jobs)
    _check_files(options)
    config = None if options.config is None else ShieldConfig.named(options.config)
    settings = read_settings(options.setting, options.env_id, options.env_config)

    from evaluation.experiments import Experiment
    from evaluation.learning.normalised_model import statistics_beside

    for name in policies:
        if name.endswith(".zip") and (statistics := statistics_beside(Path(name))):
            _err.print(f"{name}: observations are normalised by {statistics.name} beside it")
    return Experiment(
        policies,
        settings,
        modes,
        [each.value for each in Placement if each is not Placement.ALL]
        if placement is Placement.ALL
        else [placement.value],
        perceptions,
        sensors,
        episodes=options.episodes,
        seed=options.seed,
        config=config,
        algorithm=options.algorithm,
        model=options.model,
        simulator=options.simulator,
        jobs=options.jobs,
        output=options.output,
        resume=options.resume,
        shard=shard_of(options.shard),
        buffer=lengths(options.buffer or []),
        steps=options.steps,
        engine=options.engine,
        address=options.address,
    )


def _check_files(options: EvaluateOptions) -> None:
    """Raise a ConfigError for an output that cannot be written or resumed."""
    if options.resume and options.output is None:
        raise ConfigError("--resume goes with --output")
    if options.output is not None:
        check_output(options.output, options.force, options.resume)
    if options.steps is not None:
        check_steps_path(options.steps, options.force, options.resume)


def episodes_command(
    rate: Annotated[float, typer.Option(help="Crash rate to show, such as 1e-3.")],
    versus: Annotated[
        float | None, typer.Option(help="Crash rate of another policy, to be distinguished from --rate.")
    ] = None,
) -> None:
    """Print the number of episodes that a statement about a crash rate needs."""
    from evaluation.measuring.sample_size import POWER, episodes_to_tell_apart, episodes_without_a_crash

    needed = episodes_without_a_crash(rate)
    _out.print(f"{needed:,} episodes without a crash show a rate of at most {rate:g} (95 %, Clopper-Pearson)")
    if versus is not None:
        each = episodes_to_tell_apart(rate, versus)
        _out.print(f"{each:,} episodes each tell {rate:g} and {versus:g} apart (95 %, with a power of {POWER:.0%})")


def merge_command(
    output: Annotated[Path, typer.Argument(help="The .csv or .parquet to write.")],
    parts: Annotated[
        list[Path],
        typer.Argument(
            help="Files of `shield evaluate --shard i/n --output PART`, and with --steps its --steps files."
        ),
    ],
    steps: Annotated[
        Path | None,
        typer.Option(help="Write one row for each decision to this .parquet, from the parts' --steps files."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file that exists.")] = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print Markdown tables.")] = False,
    latex: Annotated[bool, typer.Option("--latex", help="Print LaTeX tables, for the package booktabs.")] = False,
) -> None:
    """Merge the shards of one experiment, and print its tables; shards of different experiments are an error."""
    form = TableFormat.of(markdown, latex)
    check_output(output, force)
    if steps is not None:
        check_steps_path(steps, force, False)
    from evaluation.experiments import Result, merge
    from evaluation.running.step_table import is_steps, keep_steps, merge_steps

    of_decisions = [part for part in parts if is_steps(part)]
    if of_decisions and steps is None:
        raise ConfigError(
            f"{of_decisions[0]} has a row for each decision; --steps FILE.parquet says where to write all"
        )
    if steps is not None and not of_decisions:
        raise ConfigError("--steps merges the files that `shield evaluate --steps` wrote; give them beside the parts")
    whole = merge([Result.read(part) for part in parts if part not in of_decisions])
    if steps is not None:
        keep_steps(steps, merge_steps(of_decisions, whole.episodes))
    report(whole.episodes, output, form, dict(whole.made))


def add_evaluating(app: typer.Typer) -> None:
    """Add these commands to the application."""
    app.command("evaluate")(one_option_a_field(evaluate_command, EvaluateOptions))
    app.command("episodes")(episodes_command)
    app.command("merge")(merge_command)
