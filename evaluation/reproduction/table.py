"""The table of the report's experiment: published beside measured values."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from dynamics.state import FloatArray
from evaluation.measuring.statistics import Interval, interquartile_mean, nested_bootstrap, wilson
from evaluation.reproduction.presets import published_for
from evaluation.reproduction.variants import VARIANTS

__all__ = ["groups_of", "summary", "table"]


def groups_of(rows: pd.DataFrame, column: str) -> list[FloatArray]:
    """A column of one variant's episodes, by training seed; in one group for variants without training."""
    values = rows[column].astype(float)
    if VARIANTS[rows["variant"].iloc[0]].learner in ("", "cem"):
        return [values.to_numpy()]
    return [each.to_numpy() for _, each in values.groupby(rows["training_seed"])]


def summary(episodes: pd.DataFrame) -> pd.DataFrame:
    """A row for each variant, in the order of the table, with 95 % intervals.

    `crash_rate` has Wilson's interval, for these models. `crash_rate_nested` has the interval over training seeds and
    episodes, and so have `return` and `iqm`, the interquartile mean of the returns. `crash_rates` and `returns` are
    those of each training seed. `slow` is a share of the policy's decisions, the other shares are of primitive steps.
    """
    found = []
    for name in (each for each in VARIANTS if each in set(episodes["variant"])):
        rows = episodes[episodes["variant"] == name]
        crashed, returns = groups_of(rows, "crashed"), groups_of(rows, "return")
        steps, n = rows["steps"].sum(), len(rows)
        row = {
            "variant": name,
            "label": VARIANTS[name].label,
            "episodes": n,
            "training_seeds": len(crashed) if VARIANTS[name].learner not in ("", "cem") else 0,
            **_flat("crash_rate", wilson(int(rows["crashed"].sum()), n)),
            **_flat("crash_rate_nested", nested_bootstrap(crashed)),
            **_flat("return", nested_bootstrap(returns)),
            **_flat("iqm", nested_bootstrap(returns, interquartile_mean)),
            "crash_rates": [float(each.mean()) for each in crashed],
            "returns": [float(each.mean()) for each in returns],
            "mean_speed": float(rows["mean_speed"].mean()),
            "slow": float(rows["slow"].sum() / rows["decisions"].sum()),
            "replaced": float(rows["replaced"].sum() / steps),
            "overridden": float(rows["overridden"].sum() / steps),
            "confidence": float(rows["confidence"].mean()),
        }
        figures = published_for(str(rows["preset"].iloc[0])).get(name)
        if figures is not None:
            row |= {
                f"published_{key}": getattr(figures, key) for key in ("mean", "deviation", "crash_rate", "confidence")
            }
        found.append(row)
    return pd.DataFrame(found)


def table(found: pd.DataFrame) -> str:
    """The summary as Markdown; rates in percent."""
    lines = []
    for row in found.to_dict("records"):
        published = pd.notna(row.get("published_mean"))
        confidence, variant = row.get("published_confidence"), VARIANTS[row["variant"]]
        lines.append(
            {
                "variant": row["label"],
                "published: crashes %": f"{100 * row['published_crash_rate']:.0f}" if published else "–",
                "return ": _published(row) if published else "–",
                "episodes": f"{row['episodes']:,}",
                "crashes %": _interval(row, "crash_rate", 100, 1 if row["crash_rate"] else 2),
                "over seeds %": _ends(row, "crash_rate_nested") if row["training_seeds"] else "–",
                "of each seed %": _each(row["crash_rates"]) if row["training_seeds"] else "–",
                "return": _interval(row, "return", 1, 2),
                "IQM": _interval(row, "iqm", 1, 2),
                "speed m/s": f"{row['mean_speed']:.1f}",
                "asks to slow down %": _share(row, "slow", variant.learner != "cem"),
                "rule %": _share(row, "replaced", bool(variant.override) or variant.report_skills),
                "shield %": _share(row, "overridden", bool(variant.shield)),
                "confidence": _number(row["confidence"]) + (f" ({confidence:.3f})" if pd.notna(confidence) else ""),
            }
        )
    return str(pd.DataFrame(lines).to_markdown(index=False, disable_numparse=True))


def _published(row: dict[str, float]) -> str:
    deviation = row["published_deviation"]
    return f"{row['published_mean']:.2f}" + (f" ± {deviation:.2f}" if pd.notna(deviation) else "")


def _flat(name: str, interval: Interval) -> dict[str, float]:
    return {name: interval.estimate, f"{name}_low": interval.low, f"{name}_high": interval.high}


def _interval(row: dict[str, float], key: str, factor: float, digits: int) -> str:
    values = [factor * row[each] for each in (key, f"{key}_low", f"{key}_high")]
    middle, low, high = (f"{each:.{digits}f}" for each in values)
    return f"{middle} [{low}, {high}]"


def _ends(row: dict[str, float], key: str) -> str:
    return f"[{100 * row[f'{key}_low']:.1f}, {100 * row[f'{key}_high']:.1f}]"


def _each(rates: Sequence[float]) -> str:
    return " ".join(f"{100 * each:.1f}" for each in rates) if any(rates) else "all 0"


def _share(row: dict[str, float], key: str, there: bool) -> str:
    return f"{100 * row[key]:.1f}" if there else "–"


def _number(value: float) -> str:
    return f"{value:.3f}" if pd.notna(value) else "–"
