"""Shields side by side: the same models and seeds on every road, behind one shield after the other.

A part is a road with its model, and a shield; each is a table of `evaluation.running.episodes` with the record of what
made it, and goes on where it was stopped.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import pandas as pd

from evaluation.measuring.metrics import summarise
from evaluation.names import check_name
from evaluation.report.table import Column, finished, markdown, write_table
from evaluation.reproduction.presets import get_preset
from evaluation.running.comparing import Comparison
from evaluation.running.manifest import provenance
from evaluation.running.processes import Processes
from evaluation.running.records import Variant, config_on
from evaluation.running.store import Store
from evaluation.settings import Setting, get_setting
from shield.config import RULES_ALONE, SIMULATED, WORST_CASE, ShieldConfig
from shield.errors import ConfigError, SceneError

__all__ = [
    "BASELINES",
    "PUBLISHED_SHIELDS",
    "ROADS",
    "SHIELDS",
    "Road",
    "compare_shields",
    "driven_on",
    "rows_of",
    "variant_on",
]

FIRST_SEED = 1_720_000
"""Of the episodes; the same in every part."""


@dataclass(frozen=True)
class Road:
    """A road and the bundled model that drives it.

    Attributes
    ----------
    name, setting, policy : of the road; the model's name.
    baselines : whether the policies that look at nothing have their rows here.
    """

    name: str
    setting: Setting
    policy: str
    baselines: bool = True


ROADS: Mapping[str, Road] = MappingProxyType(
    {
        each.name: each
        for each in (
            Road("highway-fast", get_setting("highway-fast"), "ppo-highway-fast"),
            Road("abz", get_setting("abz-idm"), "dqn-abz-base"),
            Road("abz-adversarial", get_setting("abz-idm"), "dqn-abz-adversarial", baselines=False),
            Road("merge", get_setting("merge"), "ppo-merge"),
            Road("roundabout", get_setting("roundabout"), "ppo-roundabout"),
            Road("intersection", get_setting("intersection"), "ppo-intersection"),
            Road("racetrack", get_setting("racetrack"), "ppo-racetrack"),
        )
    }
)
"""By name; the two agents of ABZ drive on the same road, whose baselines stand once."""

BASELINES: Mapping[str, str] = MappingProxyType(
    {
        "slower": "always SLOWER, no shield",
        "idle": "always IDLE, no shield",
        "faster": "always FASTER, no shield",
        "stopped": "a car that stops, no shield",
    }
)
"""Policies that look at nothing, by name."""

SHIELDS: Mapping[str, str] = MappingProxyType(
    {
        "none": "no shield",
        "distance": "the report's override as written: SLOWER in place of a lane change with somebody nearer than 20 m",
        "rss": "gaps of RSS, else SLOWER",
        "ttc-ranking": "time to collision over four decisions, down the policy's ranking to the first action that "
        "keeps it, else SLOWER (ABZ's kind)",
        "worst-case": "`ShieldedEnv` against anything that the rules of the road allow",
        "simulated": "`ShieldedEnv` in simulated traffic",
        "observed": "`ShieldedEnv` from observations alone",
        **BASELINES,
    }
)
"""Rows, by name."""

_TTC_DECISIONS = 4
_STOPPING = [0, 15, 30]
_NETWORKS = ("merge", "roundabout", "intersection")
_MOST: Mapping[tuple[str, str], int] = MappingProxyType(
    {
        **{(road, "observed"): 300 for road in ("highway-fast", "abz", "abz-adversarial")},
        **{(road, "worst-case"): 100 for road in _NETWORKS},
        ("racetrack", "worst-case"): 20,
        ("racetrack", "simulated"): 20,
    }
)
"""Episodes at most, by road and row, where an episode takes 0.2 to 20 CPU seconds."""

PUBLISHED_SHIELDS: tuple[str, ...] = (
    "ABZ 2025 (time to collision over 4 steps, down the policy's ranking; 3 lanes, 1,000 runs): crashes 38 → 0 of the "
    "base DQN and 34 → 0 of the base PPO; adversarial 966 → 2 and 989 → 9, 71 % overridden, 374 ms a decision.",
    "CARPSS (norms of time to collision and distance; 4 lanes, 500 episodes): 99.8 % success at 22.0 m/s, 45.8 % "
    "overridden; bare 51.2 % at 24.0 m/s.",
    "CPSS (arXiv 2605.18841; DQN on merge, highway, intersection, racetrack): mean collision rate 0.0822 → 0.0069.",
)
"""What others report of theirs, in settings of their own."""


def variant_on(road: Road, shield: str) -> Variant:
    """What stands between the policy and a road in a row of `SHIELDS`.

    Raises
    ------
    ConfigError
        If there is no such shield on that road.
    """
    if shield == "none" or shield in BASELINES:
        return Variant()
    if shield in RULES_ALONE and road.name in _NETWORKS:
        raise ConfigError("a rule alone reads one road of straight parallel lanes")
    if shield == "distance":
        return Variant("env", ShieldConfig(mode="distance", distance=get_preset("as-written").distance))
    if shield == "rss":
        return Variant("env", ShieldConfig(mode="rss"))
    if shield == "ttc-ranking":
        seconds = _TTC_DECISIONS / _configuration(road.setting)["policy_frequency"]
        return Variant("env", ShieldConfig(mode="ttc-ranking", time_to_collision=seconds))
    if shield == "observed":
        return Variant("env", config_on(road.setting, None, observes=True), "observation")
    return Variant("env", config_on(road.setting, {"worst-case": WORST_CASE, "simulated": SIMULATED}[shield]))


def driven_on(road: Road, shield: str) -> tuple[Setting, str]:
    """The environment and the policy of a row of `SHIELDS`.

    Raises
    ------
    ConfigError
        If there is no such baseline on that road.
    """
    if shield not in BASELINES:
        return road.setting, road.policy
    if shield != "stopped":
        return road.setting, shield
    configuration = _configuration(road.setting)
    if "duration" not in configuration:
        raise ConfigError("an episode ends at a place on this road, which a car that stops does not reach")
    action = configuration["action"]
    if action["type"] != "DiscreteMetaAction":
        raise ConfigError("a car that stops is always SLOWER with a target speed of 0, which needs meta-actions")
    return road.setting.override({"action": {**action, "target_speeds": _STOPPING}}), "slower"


def _configuration(setting: Setting) -> Mapping[str, Any]:
    env = setting.make()
    try:
        return dict(cast(Any, env.unwrapped).config)
    finally:
        env.close()


def rows_of(road: Road, shields: Iterable[str]) -> list[str]:
    """Those of `shields` that have a row on a road."""
    return [each for each in shields if road.baselines or each not in BASELINES]


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
        for shield in rows_of(road, asked):
            try:
                found = _part(folder, road, shield, min(episodes, _MOST.get((road.name, shield), episodes)), jobs)
            except (ConfigError, SceneError) as error:
                refused[f"{road.name}, {shield}"] = str(error)
                continue
            row = summarise(found)
            row["road"], row["shield"] = road.name, shield
            rows.append(row)
            if tell is not None:
                crashes = int(row["crashes"].iloc[0])
                tell(f"{road.name}, {shield}: {crashes} of {len(found)} crashed, return {row['return'].iloc[0]:.2f}")
    text = _page(rows, refused, episodes)
    (folder / "table.md").write_text(text, encoding="utf-8")
    made = provenance({"roads": chosen, "shields": asked, "episodes": episodes, "first seed": FIRST_SEED})
    (folder / "manifest.json").write_text(json.dumps({**made, "refused": refused}, indent=2) + "\n", encoding="utf-8")
    return text


def _part(folder: Path, road: Road, shield: str, episodes: int, jobs: int) -> pd.DataFrame:
    """The episodes of one row on one road; what is in the folder is not driven again."""
    path = folder / "episodes" / f"{road.name}-{shield}.parquet"
    setting, policy = driven_on(road, shield)
    seeds = range(FIRST_SEED, FIRST_SEED + episodes)
    comparison = Comparison(((setting, (variant_on(road, shield),)),), (policy,), seeds)
    store = Store(path, comparison.asked(), True, finished(path))
    try:
        driven = comparison.drive(store, Processes(jobs), progress=False)
    except (ConfigError, SceneError):
        store.finish()
        raise
    driven.attrs["made"] = store.made
    write_table(driven, path)
    store.finish()
    return driven[driven["seed"].isin(seeds)]


def _interval(row: Mapping[str, Any], key: str, factor: float = 1.0) -> str:
    value, low, high = (factor * row[f"{key}{end}"] for end in ("", "_low", "_high"))
    return f"{value:.2f} [{low:.2f}, {high:.2f}]"


def _milliseconds(row: Mapping[str, Any]) -> str:
    p50, p99 = row["latency_p50_ms"], row["latency_p99_ms"]
    return f"{p50:.1f}, {p99:.1f}" if isfinite(p50) and row["door"] != "none" else "–"


_COLUMNS = (
    Column("road", lambda row: str(row["road"])),
    Column("policy", lambda row: str(row["policy"])),
    Column("shield", lambda row: str(row["shield"])),
    Column("episodes", lambda row: f"{row['episodes']:,}"),
    Column("crashes %", lambda row: _interval(row, "crash_rate", 100.0)),
    Column("off road %", lambda row: f"{100 * row['off_road_rate']:.1f}"),
    Column("return", lambda row: _interval(row, "return")),
    Column("speed m/s", lambda row: f"{row['mean_speed']:.1f}"),
    Column("overridden %", lambda row: "–" if row["door"] == "none" else f"{100 * row['override_rate']:.1f}"),
    Column("ms p50, p99", _milliseconds),
)


def _page(rows: list[pd.DataFrame], refused: Mapping[str, str], episodes: int) -> str:
    lines = [
        "# Shields side by side",
        f"At most {episodes:,} episodes each, the same seeds from {FIRST_SEED:,} in a road's rows. Crash rates with "
        "Wilson 95 % intervals, returns with bootstrap intervals; milliseconds of the shield at each decision.",
        "\n".join(f"- *{name}*: {what}" for name, what in SHIELDS.items()),
    ]
    if rows:
        lines.append(markdown(pd.concat(rows, ignore_index=True), _COLUMNS))
    if refused:
        reasons = {reason: [name for name, each in refused.items() if each == reason] for reason in refused.values()}
        lines += ["## Refused", "\n".join(f"- {'; '.join(names)}: {reason}" for reason, names in reasons.items())]
    lines += ["## Published by others", "\n".join(f"- {each}" for each in PUBLISHED_SHIELDS)]
    return "\n\n".join(lines) + "\n"
