"""The command `falsify`, a search for the worst episode."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from evaluation.commands.reporting import check_writable
from evaluation.commands.shared_options import EnvConfig, EnvId, NamedSetting, check_jobs, read_setting
from evaluation.names import ANY, TRAFFIC, check_name, check_policy
from shield.config import ShieldConfig
from shield.errors import ConfigError

if TYPE_CHECKING:
    from evaluation.settings import Setting

__all__ = ["FalsifyOptions", "falsify_command"]

_out = Console()
_EPISODES = {"idm": 5_000, "bold": 5_000, "network": 500}


@dataclass(frozen=True)
class FalsifyOptions:
    """The options of `shield falsify`."""

    output: Annotated[Path, typer.Argument(help="JSON file for the worst episode; `shield replay --find` drives it.")]
    setting: NamedSetting = None
    env_id: EnvId = None
    env_config: EnvConfig = None
    policy: Annotated[
        str, typer.Option(help="Name of a policy, an SB3 .zip, or `any`: its actions are searched too.")
    ] = "any"
    episodes: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Number of episodes, 5,000 by default. With idm approximate, and at least 500. With other drivers the"
            " largest number; on road networks at least 50, 500 by default.",
        ),
    ] = None
    seed: Annotated[int, typer.Option(min=0, help="Seed of the search, and on road networks of its scenes.")] = 0
    config: Annotated[Path | None, typer.Option(help="Shield settings, TOML (see `shield config`).")] = None
    drivers: Annotated[
        str,
        typer.Option(
            help="Drivers of the other vehicles. idm: highway-env's own. The other drivers are in highway-env itself,"
            " up to the first find. bold: worst-case compliant (straight highways with two lanes, road networks); on"
            " road networks also wild, random throttle and steering, and mixed."
        ),
    ] = "idm"
    jobs: Annotated[int, typer.Option(help="Processes with drivers other than idm; -1 for one per core.")] = -1


def falsify_command(options: FalsifyOptions) -> None:
    """Search scenes and actions for the shielded episode that comes nearest to a crash.

    With idm: subset simulation over the numbers of a reset and the policy's actions; on road
    networks over seeds and actions, with settings that simulate the traffic. With `bold` drivers
    on straight highways: seed by seed, for a crash, or an intrusion into the buffer without a recorded
    violation (exit status 1), or for a violation recorded for a compliant driver. With drivers on
    road networks: subset simulation over their inputs and the ego's proposals, for an intrusion by
    a vehicle without a recorded violation (exit status 1).
    """
    given = None if options.config is None else ShieldConfig.load(options.config)
    check_jobs(options.jobs)
    check_writable(options.output)
    check_name("drivers", options.drivers, TRAFFIC)
    if options.policy != ANY:
        check_policy(options.policy)
    where = read_setting(options.setting, options.env_id, options.env_config)
    if options.drivers != "idm":
        if options.policy != ANY:
            raise ConfigError(f"among {options.drivers} drivers the policy is {ANY!r}, not {options.policy!r}")
        _among(options.output, where, options.drivers, given, options.episodes, options.seed, options.jobs)
        return
    from evaluation.falsification.falsify import falsify

    found = falsify(where, options.policy, given or ShieldConfig(), options.episodes or _EPISODES["idm"], options.seed)
    found.find.save(options.output)
    table = Table("", f"{found.episodes} episodes")
    table.add_row("median clearance as drawn \\[m]", f"{found.median:.3f}")
    table.add_row("smallest clearance found \\[m]", f"{found.find.clearance:.3f}")
    table.add_row("crashes in the last level", str(found.crashed))
    table.add_row("as drawn, in which the traffic broke an assumption", f"{100 * found.offended:.1f} %")
    if found.lost is not None:
        table.add_row("as drawn, in which nothing verified at first", f"{100 * found.lost:.1f} %")
    _out.print(table)
    _out.print(f"wrote {options.output}")


def _among(
    output: Path,
    setting: Setting,
    drivers: str,
    config: ShieldConfig | None,
    episodes: int | None,
    seed: int,
    jobs: int,
) -> None:
    from evaluation.falsification.falsify import falsify_among
    from evaluation.falsification.road_search import has_network, search_roads

    if has_network(setting):
        found = search_roads(setting, drivers, config, episodes or _EPISODES["network"], seed, jobs)
        table = Table("", f"{found.episodes} episodes, {found.frames} frames with a verified plan")
        table.add_row("breach without a recorded violation", "found" if found.hole else "none")
        table.add_row("frames in which a compliant vehicle reduced a margin", str(found.shrunk))
        table.add_row("median clearance from the buffer at random \\[m]", f"{found.median:.3f}")
        table.add_row("clearance from the buffer in the saved episode \\[m]", f"{found.find.clearance:.3f}")
        table.add_row("crashes of the ego", str(found.crashed))
        table.add_row("broken rules", _counts_text(found.by_rule) or "none")
        find, hole = found.find, found.hole
    else:
        if drivers != "bold":
            raise ConfigError(f"on straight highways have drivers idm or bold, not {drivers!r}: {setting.name} is one")
        met = falsify_among(setting, config or ShieldConfig(), episodes or _EPISODES["bold"], seed, jobs=jobs)
        table = Table("", f"{met.episodes} episodes, {met.began} of them from a verified start")
        table.add_row(
            "seeds with a crash or breach without a recorded violation", ", ".join(map(str, met.holes)) or "none"
        )
        named = _counts_text(met.by_rule)
        table.add_row("episodes with a recorded violation", f"{met.named} ({named})" if named else "none")
        table.add_row("clearance from the buffer in the saved episode \\[m]", f"{met.find.clearance:.3f}")
        find, hole = met.find, bool(met.holes)
    find.save(output)
    _out.print(table)
    _out.print(f"wrote {output}")
    if hole:
        raise typer.Exit(1)


def _counts_text(by_rule: dict[str, int]) -> str:
    return ", ".join(f"{rule} {count}" for rule, count in by_rule.items())
