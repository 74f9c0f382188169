"""Open-loop error of learned dynamics against the horizon."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dynamics.learned.tasks import parking_state as parking
from evaluation.measuring.dynamics_study import HORIZON, ModelTest
from evaluation.report.plots import plot_path, save_plot

__all__ = ["plot_errors"]


def plot_errors(trials: Sequence[ModelTest], path: str | Path) -> Path:
    """Plot the position error against the horizon, random driving on the left, on-policy driving on the right.

    Lines are medians over all windows and seeds. Areas reach up to the 95 % quantile.

    Parameters
    ----------
    trials : results of `evaluation.measuring.dynamics_study.study`.
    path : path of the file, ending as in `evaluation.report.plots.PLOT_ENDINGS`; folders are created.

    Returns
    -------
    The path.

    Raises
    ------
    ConfigError
        On another ending.
    """
    import matplotlib.pyplot as plt

    path = plot_path(path)
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained", sharey=True)
    time = parking.DT * np.arange(1, HORIZON + 1)
    for name in dict.fromkeys(each.name for each in trials):
        same = [each for each in trials if each.name == name]
        for axes, kind in ((left, "random"), (right, "on_policy")):
            position = np.concatenate([getattr(each, kind).position for each in same])
            if position.max() < 1e-3:
                continue
            (line,) = axes.plot(time, np.median(position, axis=0), label=name)
            high = np.quantile(position, 0.95, axis=0)
            axes.fill_between(time, np.median(position, axis=0), high, color=line.get_color(), alpha=0.12, lw=0)
    for axes, title in ((left, "random driving"), (right, "the planner's driving")):
        axes.set(title=title, xlabel="time ahead [s]", yscale="log")
        axes.grid(True, which="major", alpha=0.3)
    left.set_ylabel("position error [m], open loop")
    right.legend(fontsize="small")
    return save_plot(figure, path)
