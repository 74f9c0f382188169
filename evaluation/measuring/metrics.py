"""Summaries of tables of episodes, one row per setting, policy and shield.

The episodes are those of `evaluation.running.episodes.run_paired`. Rates and means have 95 % intervals, in columns that
end in `_low` and `_high`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from dynamics.deprecation import warn_of_former_name
from dynamics.state import FloatArray
from evaluation.measuring.attribution import Cause
from evaluation.measuring.columns import FORMER_COLUMNS, with_present_columns
from evaluation.measuring.statistics import (
    Interval,
    bootstrap_mean,
    mcnemar,
    paired_difference,
    paired_rate_difference,
    quantiles,
    wilson,
)
from shield.decision import Reason, Tier
from shield.errors import ConfigError

__all__ = ["GROUP", "STOPPED", "compare", "latencies_of", "summarise"]

GROUP = ["setting", "policy", "placement", "mode"]
"""Columns that identify a row of a summary."""

STOPPED = 1.0
"""Speed below which a vehicle has stopped at its goal [m/s]."""

_PAIR = ["setting", "policy"]
_MEANS = ("distance", "lane_changes", "laps", "mean_jerk", "mean_lateral_acceleration")
_FALLBACKS = [f"tier_{tier.value}" for tier in Tier if tier.fallback]
_REASONS = [f"reason_{reason.value}" for reason in Reason if reason is not Reason.NONE]


def summarise(episodes: pd.DataFrame) -> pd.DataFrame:
    """One row per setting, policy, `placement` and mode, in the order in which they first appear.

    Returns
    -------
    A table with, after the columns of `GROUP`:

    - `verification`: what actions were verified against, "" in older tables;
    - `episodes`, `crashes`, `off_roads`; `crash_rate`, `off_road_rate` and `ego_fault_rate` with Wilson intervals, the
      last NaN if a crash could not be attributed;
    - `success_rate` and `stopped_rate` with Wilson intervals: the goal was reached, and at less than `STOPPED` [m/s];
      NaN without a goal;
    - `return` with a bootstrap interval;
    - the means of `mean_speed` [m/s], `distance` [m], `lane_changes`, `laps`, `mean_jerk` [m/s^3] and
      `mean_lateral_acceleration` [m/s^2]; NaN where they are undefined;
    - `override_rate`, `held_back_rate`, `fallback_rate` and `reason_…`: shares of all decisions. `held_back_rate` is
      part of `override_rate`, and NaN in older tables. `frame_override_rate`: share of all simulation frames;
    - `violations`: number of violations of the assumptions by the traffic; NaN if they are not counted;
    - `min_margin` and `min_gap` [m]: the smallest of all episodes;
    - `latency_p50_ms`, `latency_p99_ms`: over all decisions of all episodes.

    Values of missing columns are NaN: the episodes of `shield certify` have no latencies, distances, jerks and reasons.

    Raises
    ------
    ConfigError
        If a column is missing, or a seed appears twice.
    """
    episodes = _checked(episodes)
    rows = []
    for key, group in episodes.groupby(GROUP, sort=False):
        rows.append({**dict(zip(GROUP, key, strict=True)), **_summary(group)})
    return pd.DataFrame(rows)


def _summary(group: pd.DataFrame) -> dict[str, Any]:
    n, decisions = len(group), int(group["steps"].sum())
    p50, p99 = quantiles(latencies_of(group))
    fallbacks = ["fallbacks"] if _has(group, ["fallbacks"]) else _FALLBACKS
    return {
        "verification": str(group["verification"].iloc[0]) if "verification" in group else "",
        "episodes": n,
        "crashes": int(group["crashed"].sum()),
        **_columns("crash_rate", wilson(int(group["crashed"].sum()), n)),
        "off_roads": int(group["off_road"].sum()),
        **_columns("off_road_rate", wilson(int(group["off_road"].sum()), n)),
        **_columns("ego_fault_rate", _ego_fault(group["attribution"], n)),
        **_arrivals(group),
        **_columns("return", bootstrap_mean(group["return"])),
        "mean_speed": float(group["mean_speed"].mean()),
        **{name: float(group[name].astype(float).mean()) if name in group else float("nan") for name in _MEANS},
        "override_rate": float(group["overridden"].sum() / decisions),
        "held_back_rate": float(group["held_back"].sum() / decisions) if "held_back" in group else float("nan"),
        "frame_override_rate": float(group["frames_overridden"].sum() / group["frames"].sum()),
        **{reason: _share(group, [reason], decisions) for reason in _REASONS},
        "fallback_rate": _share(group, fallbacks, decisions),
        "violations": float(group["violations"].astype(float).sum(skipna=False)),
        "min_margin": float(group["min_margin"].min()),
        "min_gap": float(group["min_gap"].min()),
        "latency_p50_ms": p50,
        "latency_p99_ms": p99,
    }


def latencies_of(episodes: pd.DataFrame) -> FloatArray:
    """Latencies of every decision of all episodes [ms]; empty if an episode has none."""
    if not _has(episodes, ["latencies_ms"]):
        return np.zeros(0)
    return np.concatenate([np.asarray(each, float) for each in episodes["latencies_ms"]])


def _has(group: pd.DataFrame, columns: list[str]) -> bool:
    """Whether every episode has values in all of these columns."""
    return set(columns) <= set(group.columns) and bool(group[columns].notna().to_numpy().all())


def _share(group: pd.DataFrame, columns: list[str], decisions: int) -> float:
    """Sum of columns of counts over all decisions; NaN if an episode has no value."""
    return float(group[columns].to_numpy().sum() / decisions) if _has(group, columns) else float("nan")


def _arrivals(group: pd.DataFrame) -> dict[str, float]:
    """Share of episodes that reached the goal, and that stopped there; NaN if one has no goal, or in older tables."""
    n, nothing = len(group), Interval(float("nan"), float("nan"), float("nan"), len(group))
    if "success" not in group or group["success"].isna().any():
        return {**_columns("success_rate", nothing), **_columns("stopped_rate", nothing)}
    success = group["success"].astype(bool)
    stopped = success & (group["arrival_speed"].astype(float) < STOPPED)
    return {
        **_columns("success_rate", wilson(int(success.sum()), n)),
        **_columns("stopped_rate", wilson(int(stopped.sum()), n)),
    }


def _ego_fault(causes: pd.Series, n: int) -> Interval:
    """Share of the episodes with a crash by the ego's fault; NaN if a crash could not be attributed."""
    if (causes == Cause.UNATTRIBUTED.value).any():
        return Interval(float("nan"), float("nan"), float("nan"), n)
    return wilson(int((causes == Cause.EGO_AT_FAULT.value).sum()), n)


def compare(episodes: pd.DataFrame) -> pd.DataFrame:
    """Each shielded row against unshielded driving, paired on the same seeds.

    Returns
    -------
    A table with, after the columns of `GROUP`:

    - `pairs`: number of pairs;
    - `crash_rate_difference`, `off_road_rate_difference`, `return_difference`, `mean_speed_difference` [m/s]: means
      of shielded minus unshielded, with intervals (Bonett-Price for the two rates, else bootstrap);
    - `crashes_prevented`, `crashes_added`: pairs in which only one of the two crashed, and
      `mcnemar_p`, their exact McNemar test.

    The table is empty without unshielded episodes.

    Raises
    ------
    ConfigError
        If a column is missing, or a seed appears twice.
    """
    episodes = _checked(episodes)
    rows = []
    for key, group in episodes[episodes["placement"] != "none"].groupby(GROUP, sort=False):
        names = dict(zip(GROUP, key, strict=True))
        bare = episodes[episodes["placement"] == "none"]
        for column in _PAIR:
            bare = bare[bare[column] == names[column]]
        pairs = group.merge(bare, on="seed", suffixes=("", "_bare"))
        if not pairs.empty:
            rows.append({**names, **_differences(pairs)})
    return pd.DataFrame(rows)


def _differences(pairs: pd.DataFrame) -> dict[str, Any]:
    crashed, bare = pairs["crashed"].astype(bool), pairs["crashed_bare"].astype(bool)
    out: dict[str, Any] = {
        "pairs": len(pairs),
        **_columns("crash_rate_difference", paired_rate_difference(crashed, bare)),
        **_columns(
            "off_road_rate_difference",
            paired_rate_difference(pairs["off_road"].astype(bool), pairs["off_road_bare"].astype(bool)),
        ),
    }
    for name in ("return", "mean_speed"):
        difference = paired_difference(pairs[name], pairs[f"{name}_bare"])
        out |= _columns(f"{name}_difference", difference)
    test = mcnemar(bare, crashed)
    return out | {
        "crashes_prevented": test.only_first,
        "crashes_added": test.only_second,
        "mcnemar_p": test.p_value,
    }


def _columns(name: str, interval: Interval) -> dict[str, float]:
    return {name: interval.estimate, f"{name}_low": interval.low, f"{name}_high": interval.high}


def _checked(episodes: pd.DataFrame) -> pd.DataFrame:
    """The table with the present names of its columns; raises `ConfigError` if it is no table of episodes."""
    for former in FORMER_COLUMNS.keys() & set(episodes.columns):
        warn_of_former_name(f"the column {former!r}", f"rename it to {FORMER_COLUMNS[former]!r}", stacklevel=4)
    episodes = with_present_columns(episodes)
    missing = sorted({*GROUP, "seed", "crashed", "off_road", "return"} - set(episodes.columns))
    if missing:
        raise ConfigError(f"this is not a table of episodes: column {missing[0]!r} is missing")
    if episodes.duplicated([*GROUP, "seed"]).any():
        raise ConfigError("the same seed appears twice under one setting, policy, placement and mode")
    return episodes
