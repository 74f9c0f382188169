"""`shield demo --env-id`: always FASTER on a road, with and without the shield in simulated traffic."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from evaluation.commands.reporting import report
from evaluation.report.gallery import ROADS, draw_gallery
from evaluation.running.episodes import RunOptions, run_paired
from evaluation.running.named_policies import make_policy
from evaluation.running.records import make_variants
from evaluation.settings import Setting, setting_of
from shield.config import ShieldConfig
from shield.errors import ConfigError, ShieldError
from shield.filters.simulated.meta_actions import SimulatedMetaActionFilter

__all__ = ["check_road", "road_demo"]

_POLICY = "faster"


def road_demo(env_id: str, seeds: Sequence[int], output: Path, jobs: int) -> Path:
    """Print and write the episodes, and draw a decision.

    Parameters
    ----------
    env_id : the environment.
    seeds : seeds of the episodes.
    output : folder; created if it does not exist.
    jobs : processes.

    Returns
    -------
    The path of the picture.

    Raises
    ------
    ConfigError
        Before the first episode, if there is no such environment, it has no FASTER, or its traffic cannot be simulated.
    """
    setting, config = setting_of(env_id), ShieldConfig.simulated_traffic()
    check_road(setting, config)
    variants = make_variants(["none", "full"], ["actions"], config)
    frame = run_paired(setting, _POLICY, variants, seeds, jobs=jobs, run=RunOptions(progress=True))
    report(frame, output / "episodes.parquet")
    return draw_gallery(output / "override.png", [env_id])


def check_road(setting: Setting, config: ShieldConfig) -> None:
    """Check that the demo supports the environment.

    Raises
    ------
    ConfigError
        With a list of supported roads.
    """
    try:
        env = setting.make()
        try:
            make_policy(_POLICY, env)
            SimulatedMetaActionFilter(env.unwrapped, config)
        finally:
            env.close()
    except ShieldError as error:
        raise ConfigError(
            f"the demo drives always FASTER, a meta-action, and verifies it by simulation: not in {setting.env_id}. "
            f"Have {', '.join(ROADS)} (with make, ENV=merge and so on). ({error})"
        ) from error
