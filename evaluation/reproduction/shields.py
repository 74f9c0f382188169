"""Shields side by side: the same models and seeds on every road, behind one shield after the other.

A part is a road with its model, and a shield; each is a table of `evaluation.running.episodes` with the record of what
made it, and goes on where it was stopped.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import pandas as pd

from evaluation.measuring.metrics import summarise
from evaluation.names import check_name
from evaluation.report.table import finished, markdown, write_table
from evaluation.running.comparing import Comparison
from evaluation.running.records import Variant, config_on
from evaluation.running.store import Store, provenance
from evaluation.settings import Setting, get_setting
from shield.config import SIMULATED, WORST_CASE, ShieldConfig
from shield.errors import ConfigError

__all__ = ["PUBLISHED_SHIELDS", "ROADS", "SHIELDS", "Road", "compare_shields", "variant_on"]

FIRST_SEED = 972_000
"""Of the episodes; the same in every part."""


@dataclass(frozen=True)
class Road:
    """A road, the bundled model that drives it, and what limits the number of its episodes."""

    name: str
    setting: Setting
    policy: str
    most: int = 1_000_000


_AS_CODED = Setting(
    "roundabout-as-coded",
    "roundabout-v0",
    {
        "duration": 60,
        "simulation_frequency": 15,
        "policy_frequency": 15,
        "action": {"type": "DiscreteMetaAction", "target_speeds": [20, 25, 30]},
        "other_vehicles_type": "highway_env.vehicle.behavior.AggressiveVehicle",
        "collision_reward": -5,
        "lane_change_reward": -0.1,
        "reward_speed_range": [20, 30],
        "normalize_reward": False,
    },
    "the report's hard roundabout as its script makes it: the car cannot stop",
)

ROADS: Mapping[str, Road] = MappingProxyType(
    {
        each.name: each
        for each in (
            Road("highway-fast", get_setting("highway-fast"), "ppo-highway-fast"),
            Road("abz", get_setting("abz-idm"), "dqn-abz-base"),
            Road("abz-adversarial", get_setting("abz-idm"), "dqn-abz-adversarial"),
            Road("merge", get_setting("merge"), "ppo-merge"),
            Road("roundabout", get_setting("roundabout"), "ppo-roundabout"),
            Road("roundabout-as-coded", _AS_CODED, "faster", most=300),
            Road("intersection", get_setting("intersection"), "ppo-intersection"),
            Road("racetrack", get_setting("racetrack"), "ppo-racetrack"),
        )
    }
)
"""By name. `AggressiveVehicle` on networks is not compiled: at most 300 episodes of that roundabout."""

SHIELDS: Mapping[str, str] = MappingProxyType(
    {
        "none": "no shield",
        "distance": "the report's override as written: SLOWER in place of a lane change with somebody nearer than D",
        "rss": "gaps of RSS, else SLOWER",
        "ttc": "time to collision in the lane of the target, else SLOWER",
        "worst-case": "`ShieldedEnv` against anything that the rules of the road allow",
        "simulated": "`ShieldedEnv` in simulated traffic",
        "observed": "`ShieldedEnv` from observations alone",
    }
)
"""By name."""

PUBLISHED_SHIELDS: tuple[str, ...] = (
    "ABZ 2025 (time to collision over 4 steps, down the policy's ranking; 3 lanes, 1,000 runs): crashes 38 → 0 of the "
    "base DQN and 34 → 0 of the base PPO; adversarial 966 → 2 and 989 → 9, 71 % overridden, 374 ms a decision.",
    "CARPSS (norms of time to collision and distance; 4 lanes, 500 episodes): 99.8 % success at 22.0 m/s, 45.8 % "
    "overridden; bare 51.2 % at 24.0 m/s.",
    "CPSS (arXiv 2605.18841; DQN on merge, highway, intersection, racetrack): mean collision rate 0.0822 → 0.0069.",
)
"""What others report of theirs, in settings of their own."""


def variant_on(road: Road, shield: str) -> Variant:
    """What stands between the model and a road."""
    if shield == "none":
        return Variant()
    if shield in ("distance", "rss", "ttc"):
        return Variant("env", ShieldConfig(mode=shield))
    if shield == "observed":
        return Variant("env", config_on(road.setting, None, observes=True), "observation")
    return Variant("env", config_on(road.setting, {"worst-case": WORST_CASE, "simulated": SIMULATED}[shield]))


def compare_shields(
    folder: Path,
    episodes: int,
    roads: Iterable[str] = (),
    shields: Iterable[str] = (),
    jobs: int = 1,
    tell: Callable[[str], None] | None = None,
) -> str:
    """Drive whatever is not in the folder yet; write table.md and manifest.json.

    Parameters
    ----------
    folder : where parts are kept. episodes : of each part. roads, shields : by name; all by default.
    jobs : processes; -1 for one per core. tell : called with a line after each part.

    Returns
    -------
    The text of table.md.

    Raises
    ------
    ConfigError
        If there is no such road or shield, or the folder holds another experiment.
    """
    chosen, asked = list(roads) or list(ROADS), list(shields) or list(SHIELDS)
    for name in chosen:
        check_name("road", name, ROADS)
    for name in asked:
        check_name("shield", name, SHIELDS)
    (folder / "episodes").mkdir(parents=True, exist_ok=True)
    rows, refused = [], dict[str, str]()
    for road in (ROADS[name] for name in chosen):
        for shield in asked:
            path = folder / "episodes" / f"{road.name}-{shield}.parquet"
            try:
                variant = variant_on(road, shield)
            except ConfigError as error:
                refused[f"{road.name}, {shield}"] = str(error)
                continue
            seeds = range(FIRST_SEED, FIRST_SEED + min(episodes, road.most))
            comparison = Comparison(((road.setting, (variant,)),), (road.policy,), seeds)
            store = Store(path, comparison.asked(), True, finished(path))
            try:
                driven = comparison.drive(store, jobs, progress=False)
            except ConfigError as error:
                refused[f"{road.name}, {shield}"] = str(error)
                store.finish()
                continue
            driven.attrs["made"] = store.made
            write_table(driven, path)
            store.finish()
            found = driven[driven["seed"].isin(seeds)]
            row = summarise(found)
            row["door"], row["mode"], row["setting"] = shield, "", road.name
            rows.append(row)
            if tell is not None:
                crashes = int(row["crashes"].iloc[0])
                tell(f"{road.name}, {shield}: {crashes} of {len(found)} crashed, return {row['return'].iloc[0]:.2f}")
    text = _page(rows, refused, episodes)
    (folder / "table.md").write_text(text, encoding="utf-8")
    made = provenance({"roads": chosen, "shields": asked, "episodes": episodes, "first seed": FIRST_SEED})
    (folder / "manifest.json").write_text(json.dumps({**made, "refused": refused}, indent=2) + "\n", encoding="utf-8")
    return text


def _page(rows: list[pd.DataFrame], refused: Mapping[str, str], episodes: int) -> str:
    lines = [
        "# Shields side by side",
        f"At most {episodes:,} episodes each, the same seeds from {FIRST_SEED:,} in a road's rows, 95 % intervals.",
        "\n".join(f"- *{name}*: {what}" for name, what in SHIELDS.items()),
    ]
    if rows:
        whole = pd.concat(rows, ignore_index=True)
        lines.append(markdown(whole))
    if refused:
        lines += ["## Refused", "\n".join(f"- {name}: {reason}" for name, reason in refused.items())]
    lines += ["## Published by others", "\n".join(f"- {each}" for each in PUBLISHED_SHIELDS)]
    return "\n\n".join(lines) + "\n"
