"""Pictures of a table of episodes: benefits and costs of the shield, and reasons of its interventions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from evaluation.measuring.metrics import GROUP, summarise
from shield.errors import ConfigError

__all__ = ["PLOT_ENDINGS", "picture_path", "plot_episodes", "plot_path", "save_plot"]

PLOT_ENDINGS = (".pdf", ".png", ".svg")
"""File endings that `plot_episodes` writes."""

_MOST_REASONS = 6


def plot_episodes(episodes: pd.DataFrame, path: str | Path) -> Path:
    """Draw a table of episodes, a bar for each policy and shield, in four panels.

    The panels show the crash rate [%] with its Wilson interval, the return with its bootstrap interval, overridden
    decisions [%] by reason, and the distribution of the least gap between bodies in an episode [m], with crashes.

    Parameters
    ----------
    episodes : table of `evaluation.running.episodes.run_paired`, or `evaluation.report.table.read_episodes`.
    path : path of the file, ending as in `PLOT_ENDINGS`; folders are created.

    Returns
    -------
    The path.

    Raises
    ------
    ConfigError
        On another ending, or a table of something else.
    """
    import matplotlib.pyplot as plt

    path = plot_path(path)
    summary = summarise(episodes)
    names = _names(summary)
    figure, axes = plt.subplots(2, 2, figsize=(11, 2.6 + 0.7 * len(names)), layout="constrained", sharey=True)
    (crashes, returns), (overrides, gaps) = axes
    _intervals(crashes, summary, "crash_rate", "crashed [% of episodes]", 100.0)
    _intervals(returns, summary, "return", "return")
    _reasons(overrides, summary)
    _gaps(gaps, episodes)
    for axis in axes.flat:
        axis.set_yticks(range(len(names)), names)
        axis.spines[["top", "right"]].set_visible(False)
    crashes.invert_yaxis()
    counts = sorted({int(n) for n in summary["episodes"]})
    figure.suptitle(f"{' / '.join(map(str, counts))} episodes a row; lines are 95 % intervals", fontsize=10)
    return save_plot(figure, path)


def plot_path(path: str | Path) -> Path:
    """The path of a plot.

    Raises
    ------
    ConfigError
        On another ending than those of `PLOT_ENDINGS`.
    """
    return _path("plot", path, PLOT_ENDINGS)


def picture_path(path: str | Path) -> Path:
    """The path of a raster picture.

    Raises
    ------
    ConfigError
        On another ending than .png.
    """
    return _path("picture", path, (".png",))


def _path(what: str, path: str | Path, endings: tuple[str, ...]) -> Path:
    path = Path(path)
    if path.suffix not in endings:
        raise ConfigError(f"a {what} is written as {', '.join(endings)}, not {path.suffix or 'without an ending'!r}")
    return path


def save_plot(figure: Any, path: Path, dpi: int = 150) -> Path:
    """Write a figure, and close it; folders are created. Returns the path."""
    import matplotlib.pyplot as plt

    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi)
    plt.close(figure)
    return path


def _names(summary: pd.DataFrame) -> list[str]:
    """A label for each row: the names in which the rows differ, and the shield."""
    varying = [column for column in GROUP[:2] if summary[column].nunique() > 1]
    placements = summary.loc[summary["placement"] != "none", "placement"].nunique() > 1
    labels = []
    for row in summary.to_dict("records"):
        shield = "no shield" if row["placement"] == "none" else f"shield {row['mode']}"
        if placements and row["placement"] != "none":
            shield += f" ({row['placement']})"
        labels.append(", ".join([*(str(row[column]) for column in varying), shield]))
    return labels


def _intervals(axis: Any, summary: pd.DataFrame, key: str, label: str, factor: float = 1.0) -> None:
    low, middle, high = (factor * summary[f"{key}{end}"].to_numpy(float) for end in ("_low", "", "_high"))
    places = np.arange(len(summary))
    axis.barh(places, middle, color="#4c78a8", alpha=0.85)
    axis.hlines(places, low, high, color="black", linewidth=1.5)
    for place, value in zip(places, middle, strict=True):
        axis.annotate(f"{value:.1f}", (value, place), (4, 6), textcoords="offset points", fontsize=8)
    axis.set_xlabel(label)
    if factor != 1.0:
        axis.set_xlim(left=0.0)


def _reasons(axis: Any, summary: pd.DataFrame) -> None:
    columns = [c for c in summary.columns if c.startswith("reason_") and summary[c].sum() > 0]
    columns.sort(key=lambda c: -summary[c].sum())
    shares = {c.removeprefix("reason_"): 100 * summary[c].to_numpy(float) for c in columns[:_MOST_REASONS]}
    if rest := columns[_MOST_REASONS:]:
        shares["others"] = 100 * summary[rest].sum(axis=1).to_numpy(float)
    left = np.zeros(len(summary))
    for name, share in shares.items():
        axis.barh(np.arange(len(summary)), share, left=left, label=name)
        left += share
    axis.set_xlabel("decisions overridden [%]")
    if shares:
        axis.legend(fontsize=8, frameon=False)


def _gaps(axis: Any, episodes: pd.DataFrame) -> None:
    groups: Sequence[Any] = [group["min_gap"].to_numpy(float) for _, group in episodes.groupby(GROUP, sort=False)]
    for place, gap in enumerate(groups):
        finite = gap[np.isfinite(gap)]
        if len(finite):
            axis.boxplot(finite, positions=[place], orientation="horizontal", widths=0.6, sym=".")
    axis.set_xlabel("smallest gap to another body in an episode [m]")
