"""The command `replay`: repeats one shielded episode, as text, as a film, or as a page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from evaluation.commands.options_command import one_option_a_field
from evaluation.commands.shared_options import EnvConfig, EnvId, NamedSetting, read_setting
from evaluation.names import check_policy
from shield.config import ShieldConfig
from shield.decision import Decision
from shield.errors import ConfigError

if TYPE_CHECKING:
    from evaluation.replay.collect import ReplayRequest
    from evaluation.running.records import EpisodeRecord

__all__ = ["add_replaying"]

_out, _err = Console(), Console(stderr=True, highlight=False)
_POLICY = "faster"
"""Default policy for a seed."""


@dataclass(frozen=True)
class ReplayOptions:
    """The options of `shield replay`."""

    what: Annotated[
        str | None,
        typer.Argument(
            metavar="[SEED|RUN]",
            help="Seed of an episode, or a file of `shield evaluate --output`, or a folder of `shield certify`.",
        ),
    ] = None
    number: Annotated[int | None, typer.Option("--seed", min=0, help="Seed of the episode.")] = None
    episode: Annotated[int | None, typer.Option(min=0, help="Row of a run's table, from 0 on.")] = None
    setting: NamedSetting = None
    env_id: EnvId = None
    env_config: EnvConfig = None
    policy: Annotated[
        str | None, typer.Option(help=f"Name of a policy, or an SB3 .zip [{_POLICY}; that of the run].")
    ] = None
    config: Annotated[Path | None, typer.Option(help="Shield settings, TOML (see `shield config`).")] = None
    page: Annotated[
        Path | None,
        typer.Option("--html", help="Write a page with the episode; by default beside the file of a run."),
    ] = None
    film: Annotated[Path | None, typer.Option(help="Write a .gif of the episode's end.")] = None
    find: Annotated[Path | None, typer.Option(help="Find of `shield falsify`, instead of a seed.")] = None


def replay_command(options: ReplayOptions) -> None:
    """Drive one shielded episode in highway-env itself, and print one line for each override with
    its explanation.

    With --html, or for a run, writes one HTML file that opens offline: the episode frame by
    frame, and a simulation of each refused proposal.
    """
    if sum(each is not None for each in (options.what, options.number, options.find)) != 1:
        raise ConfigError("have either the seed of an episode, or a run with --episode, or --find with the file of one")
    if options.find is not None:
        _replay_find(options.find)
        return
    seed = options.number if options.what is None else int(options.what) if options.what.isdecimal() else None
    if seed is None:
        assert options.what is not None
        others = (options.setting, options.env_id, options.env_config, options.config, options.film)
        if any(each is not None for each in others):
            raise ConfigError("a run says itself what was driven; leave --setting, --env-id, --config and --film out")
        _replay_run(options.what, options.episode, options.policy, options.page)
        return
    if options.episode is not None:
        raise ConfigError("--episode goes with a run, which is a file; the seed says the episode")
    policy = options.policy or _POLICY
    check_policy(policy)
    loaded = None if options.config is None else ShieldConfig.named(options.config)
    where = read_setting(options.setting, options.env_id, options.env_config)
    from evaluation.replay.collect import ReplayRequest
    from evaluation.replay.html import page_path
    from evaluation.report.video import film_end, film_path
    from evaluation.running.records import config_on, variant_for

    film = None if options.film is None else film_path(options.film)
    page = None if options.page is None else page_path(options.page)
    shield_config = config_on(where, loaded)
    _drive(ReplayRequest(where, policy, variant_for(shield_config, where), seed), page)
    if film is not None:
        made = film_end(film, where, policy, seed, shield_config)
        _out.print(f"wrote {made.path} ({made.frames} frames)")


def _drive(request: ReplayRequest, page: Path | None) -> EpisodeRecord:
    """Drive an episode, print its overrides, and write its page if a path is given."""
    from evaluation.running.episodes import run_episode

    def tell(time: float, step: Decision) -> None:
        if step.overridden or step.tier.fallback:
            _out.print(f"{time:5.1f} s  {step.explain()}", highlight=False, markup=False, soft_wrap=True)

    if page is None:
        record = run_episode(
            request.setting, request.policy, request.variant, request.seed, simulator="highway-env", after=tell
        )
        _summary(record)
        return record
    from evaluation.replay.collect import collect
    from evaluation.replay.html import write_page

    replayed, record = collect(request, on_step=tell)
    _summary(record)
    path = write_page(replayed, page)
    _out.print(
        f"wrote {path} ({len(replayed.overrides)} overrides, {path.stat().st_size / 1e6:.2f} MB)", soft_wrap=True
    )
    return record


def _summary(record: EpisodeRecord) -> None:
    table = Table("", f"seed {record.seed}", show_header=True)
    for name in (
        "crashed",
        "attribution",
        "return_",
        "steps",
        "overridden",
        "held_back",
        "violations",
        "min_margin",
        "min_gap",
    ):
        table.add_row(name.rstrip("_").replace("_", " "), str(getattr(record, name)))
    fallbacks: Mapping[str, Any] = {tier: count for tier, count in record.tiers.items() if count}
    table.add_row("decisions by tier", ", ".join(f"{tier} {count}" for tier, count in fallbacks.items()))
    _out.print(table)


def _replay_run(run: str, episode: int | None, policy: str | None, page: Path | None) -> None:
    """Drive an episode of a run again, and write its page; exits with status 1 if the episode differs."""
    from evaluation.replay.html import page_path
    from evaluation.replay.run_file import check_same, episode_of, run_file

    path = run_file(run)
    if episode is None:
        raise ConfigError(f"have --episode with the row of {run} that is to be replayed, from 0 on")
    page = page_path(path.with_name(f"{path.stem}-episode-{episode}.html") if page is None else page)
    recorded = episode_of(path, episode, policy)
    if recorded.changed:
        _err.print(f"driven with other versions then: {', '.join(recorded.changed)}", style="yellow", soft_wrap=True)
    if differ := check_same(recorded, _drive(recorded.request, page)):
        _err.print(
            f"this is not the episode of the run: {', '.join(differ)}", style="red", markup=False, soft_wrap=True
        )
        raise typer.Exit(1)


def _replay_find(path: Path) -> None:
    if not path.is_file():
        raise ConfigError(f"there is no file {path}")
    from evaluation.falsification.finds import Find, changed, replay

    found = Find.load(path)
    if others := changed(found):
        _err.print(f"found with other versions: {', '.join(others)}", style="yellow", markup=False, soft_wrap=True)
    if not found.made:
        _err.print(f"{path.name} does not say what it was found with, so that nothing can be compared", style="yellow")
    again = replay(found)
    table = Table("", "searched", "highway-env")
    table.add_row("smallest clearance \\[m]", f"{found.clearance:.3f}", f"{again.clearance:.3f}")
    _out.print(table)


def add_replaying(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("replay")(one_option_a_field(replay_command, ReplayOptions))
