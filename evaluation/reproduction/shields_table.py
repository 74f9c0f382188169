"""Comparison of shields: the same models and seeds on every road, with one shield after the other.

All rows are in one store of episodes (`evaluation.running.store`), which a stopped run continues.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import pandas as pd

from evaluation.measuring.metrics import summarise
from evaluation.names import check_name
from evaluation.report.table import Column, markdown
from evaluation.reproduction.shields import MOST, ROADS, SHIELDS, ShieldTableRoad, driven_on, rows_of, variant_on
from evaluation.running.comparing import Comparison
from evaluation.running.episodes import RunOptions, run_paired
from evaluation.running.manifest import SECTIONS
from evaluation.running.processes import Processes
from evaluation.running.records import ShieldVariant
from evaluation.running.store import Store
from evaluation.settings import Setting
from shield.errors import ConfigError, SceneError

__all__ = ["FIRST_SEED", "PUBLISHED_SHIELDS", "compare_shields"]

FIRST_SEED = 1_720_000
"""Seed of the first episode, the same in every part."""

PUBLISHED_SHIELDS: tuple[str, ...] = (
    "ABZ 2025 (time to collision over 4 steps, down the policy's ranking; 3 lanes, 1,000 runs): crashes 38 → 0 of the "
    "base DQN and 34 → 0 of the base PPO; adversarial 966 → 2 and 989 → 9, 71 % overridden, 374 ms a decision.",
    "CARPSS (norms of time to collision and distance; 4 lanes, 500 episodes): 99.8 % success at 22.0 m/s, 45.8 % "
    "overridden; bare 51.2 % at 24.0 m/s.",
    "CPSS (arXiv 2605.18841; DQN on merge, highway, intersection, racetrack): mean collision rate 0.0822 → 0.0069.",
)
"""Published results of other shields, in their own settings."""


def compare_shields(
    folder: Path,
    episodes: int,
    roads: Iterable[str] = (),
    shields: Iterable[str] = (),
    jobs: int = 1,
    tell: Callable[[str], None] | None = None,
) -> str:
    """Drive the episodes that are not in the folder yet, and write table.md there.

    Parameters
    ----------
    folder : folder of the store of episodes.
    episodes : episodes of each part.
    roads, shields : names; all by default.
    jobs : processes; -1 for one per core.
    tell : called with a line after each part.

    Returns
    -------
    The text of table.md.

    Raises
    ------
    ConfigError
        If there is no such road or shield, or the folder holds another experiment or rows of an earlier version, or
        cannot be written.
    """
    chosen, shield_names = list(roads) or list(ROADS), list(shields) or list(SHIELDS)
    for name in chosen:
        check_name("road", name, ROADS)
    for name in shield_names:
        check_name("shield", name, SHIELDS)
    if (folder / "episodes").is_dir():
        raise ConfigError(f"{folder} holds rows of an earlier version, which was no store; take another --out")
    parts, refused = _parts([ROADS[name] for name in chosen], shield_names, episodes)
    store = Store.in_folder(folder, *_identity(parts, episodes, refused), "take another --out")
    rows, run = [], RunOptions(Processes(jobs), store)
    for part in parts:
        if part.name in refused:
            continue
        try:
            found = run_paired(part.setting, part.policy, [part.variant], part.seeds, run=run)
        except (ConfigError, SceneError) as error:
            refused[part.name] = str(error)
            continue
        row = summarise(found)
        row["road"], row["shield"] = part.road, part.shield
        rows.append(row)
        if tell is not None:
            crashes = int(row["crashes"].iloc[0])
            tell(f"{part.name}: {crashes} of {len(found)} crashed, return {row['return'].iloc[0]:.2f}")
    text = _page(rows, refused, episodes)
    (folder / "table.md").write_text(text, encoding="utf-8")
    store.note({"refused": refused})
    return text


@dataclass(frozen=True)
class _Part:
    """One row on one road: its environment, policy, variant and seeds."""

    road: str
    shield: str
    setting: Setting
    policy: str
    variant: ShieldVariant
    seeds: range

    @property
    def name(self) -> str:
        return f"{self.road}, {self.shield}"


def _parts(
    roads: Iterable[ShieldTableRoad], shields: Iterable[str], episodes: int
) -> tuple[list[_Part], dict[str, str]]:
    """The rows of each road, and for unsupported rows the reason."""
    parts, refused = [], dict[str, str]()
    for road in roads:
        for shield in rows_of(road, shields):
            count = min(episodes, MOST.get((road.name, shield), episodes))
            try:
                driven, variant = driven_on(road, shield), variant_on(road, shield)
            except (ConfigError, SceneError) as error:
                refused[f"{road.name}, {shield}"] = str(error)
                continue
            parts.append(_Part(road.name, shield, *driven, variant, range(FIRST_SEED, FIRST_SEED + count)))
    return parts, refused


def _identity(parts: Iterable[_Part], episodes: int, refused: dict[str, str]) -> tuple[dict[str, Any], dict[str, str]]:
    """The values that determine the rows, and the hash of each model file (see `Store`).

    Parts that cannot be driven are added to `refused`.
    """
    specification: dict[str, Any] = {**{key: {} for key in SECTIONS}, "seed": FIRST_SEED, "episodes": episodes}
    models, tried = dict[str, str](), dict[tuple[str, str], dict[str, Any]]()
    for part in parts:
        comparison = Comparison(
            ((part.setting, (part.variant,)),), (part.policy,), range(FIRST_SEED, FIRST_SEED + episodes)
        )
        key = part.setting.name, part.policy
        try:
            tried[key] = tried.get(key) or comparison.specification()
        except (ConfigError, SceneError) as error:
            refused[part.name] = str(error)
            continue
        part_specification = {**tried[key], "shields": comparison.shields()}
        specification = {
            **part_specification,
            **{section: {**specification[section], **part_specification[section]} for section in SECTIONS},
        }
        models |= comparison.models
    return specification, models


def _interval(row: Mapping[str, Any], key: str, factor: float = 1.0) -> str:
    value, low, high = (factor * row[f"{key}{end}"] for end in ("", "_low", "_high"))
    return f"{value:.2f} [{low:.2f}, {high:.2f}]"


def _milliseconds(row: Mapping[str, Any]) -> str:
    p50, p99 = row["latency_p50_ms"], row["latency_p99_ms"]
    return f"{p50:.1f}, {p99:.1f}" if isfinite(p50) and row["placement"] != "none" else "–"


_COLUMNS = (
    Column("road", lambda row: str(row["road"])),
    Column("policy", lambda row: str(row["policy"])),
    Column("shield", lambda row: str(row["shield"])),
    Column("episodes", lambda row: f"{row['episodes']:,}"),
    Column("crashes %", lambda row: _interval(row, "crash_rate", 100.0)),
    Column("off road %", lambda row: f"{100 * row['off_road_rate']:.1f}"),
    Column("return", lambda row: _interval(row, "return")),
    Column("speed m/s", lambda row: f"{row['mean_speed']:.1f}"),
    Column("overridden %", lambda row: "–" if row["placement"] == "none" else f"{100 * row['override_rate']:.1f}"),
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
