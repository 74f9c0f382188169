"""Plot of crashes, returns and overrides against sensor noise, from a table of episodes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from evaluation.measuring.metrics import GROUP, summarise
from evaluation.measuring.statistics import bootstrap_mean
from evaluation.report.plots import plot_path, save_plot
from evaluation.wrappers.sensor_model import SensorModel, get_sensor
from shield.errors import ConfigError

__all__ = ["plot_noise"]

_EXACT = "exact"
_COLORS = ("#4c78a8", "#f58518", "#54a24b", "#b279a2", "#e45756", "#72b7b2")


def plot_noise(episodes: pd.DataFrame, path: str | Path) -> Path:
    """Draw a line with a band for each policy and shield, over the standard deviation of the sensor's noise.

    The three panels show the crash rate [%] with its Wilson interval, and the return and the share of overridden
    decisions [%] with bootstrap intervals; all intervals are 95 %.

    Parameters
    ----------
    episodes : table of `shield evaluate --sensor exact,normalised-0.1,normalised-0.2`, or with metric sensors.
    path : path of the file, ending as in `PLOT_ENDINGS`; folders are created.

    Returns
    -------
    The path.

    Raises
    ------
    ConfigError
        On another ending, a table of something else, sensors of different kinds, or less than two sensors.
    """
    import matplotlib.pyplot as plt

    path = plot_path(path)
    rows = _against_noise(episodes)
    figure, axes = plt.subplots(1, 3, figsize=(13, 4.2), layout="constrained")
    # Policies that were trained with a sensor have its name in theirs; together they are one line.
    for color, (name, line) in zip(_COLORS * len(rows), rows.groupby("line", sort=False), strict=False):
        ordered = line.sort_values("sigma")
        for axis, key in zip(axes, ("crashed", "return", "overridden"), strict=True):
            low, middle, high = (ordered[f"{key}{end}"].to_numpy(float) for end in ("_low", "", "_high"))
            sigma = ordered["sigma"].to_numpy(float)
            axis.plot(sigma, middle, "o-", color=color, label=str(name), markersize=4)
            axis.fill_between(sigma, low, high, color=color, alpha=0.2, linewidth=0)
    unit = rows["unit"].iloc[0]
    for axis, label in zip(axes, ("crashed [% of episodes]", "return", "decisions overridden [%]"), strict=True):
        axis.set_xlabel(f"standard deviation of the noise [{unit}]")
        axis.set_ylabel(label)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylim(bottom=0.0)
    axes[2].set_ylim(0.0, 102.0)
    figure.legend(*axes[1].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8, frameon=False)
    counts = sorted({int(n) for n in rows["episodes"]})
    figure.suptitle(f"{' / '.join(map(str, counts))} episodes a point; bands are 95 % intervals", fontsize=10)
    return save_plot(figure, path)


def _against_noise(episodes: pd.DataFrame) -> pd.DataFrame:
    """A row for each setting, policy and shield, with the sensor's noise and intervals [%]."""
    kinds, rows = set[str](), list[dict[str, Any]]()
    sensors = episodes.groupby("policy")["setting"].nunique()
    for row in summarise(episodes).to_dict("records"):
        setting, _, sensor = str(row["setting"]).partition(", ")
        kind, sigma = _noise(sensor or _EXACT)
        kinds |= {kind} - {_EXACT}
        own = episodes[(episodes[GROUP] == [row[x] for x in GROUP]).all(axis=1)]
        overridden = bootstrap_mean(100.0 * own["overridden"].to_numpy(float) / own["steps"].to_numpy(float))
        policy = str(row["policy"])
        if sensors[policy] == 1:
            policy = policy.removesuffix(f"-{sensor or _EXACT}")
        shield = "no shield" if row["placement"] == "none" else f"{row['mode']} at {row['placement']}"
        rows.append(
            {
                "line": f"{setting}, {policy}, {shield}",
                "sigma": sigma,
                "episodes": row["episodes"],
                **{f"crashed{end}": 100.0 * row[f"crash_rate{end}"] for end in ("", "_low", "_high")},
                **{f"return{end}": row[f"return{end}"] for end in ("", "_low", "_high")},
                "overridden": overridden.estimate,
                "overridden_low": overridden.low,
                "overridden_high": overridden.high,
            }
        )
    if len(kinds) > 1 or len({row["sigma"] for row in rows}) < 2:
        raise ConfigError(
            "have rows through at least two sensors of one kind, such as --sensor exact,normalised-0.2,normalised-0.5"
        )
    unit = "m, m/s" if kinds == {"metric"} else "normalised: a feature goes from −1 to 1"
    return pd.DataFrame(rows).assign(unit=unit)


def _noise(sensor: str) -> tuple[str, float]:
    """Kind and standard deviation of a sensor; 0 for an exact one."""
    model = get_sensor(sensor)
    if model == SensorModel():
        return _EXACT, 0.0
    plain, sigmas = SensorModel(model.sigma, normalised=model.normalised), set(model.sigma.values())
    if model != plain or len(sigmas) != 1:
        raise ConfigError(f"the sensor {sensor!r} is not metric-S or normalised-S with a number S")
    return "normalised" if model.normalised else "metric", sigmas.pop()
