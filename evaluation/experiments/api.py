"""`evaluate` and `compare`: an experiment in one call."""

from __future__ import annotations

from typing import Any

import pandas as pd

from evaluation.experiments.experiment import Experiment
from evaluation.experiments.result import Result
from evaluation.measuring import metrics
from shield.errors import ConfigError

__all__ = ["compare", "evaluate"]


def evaluate(policy: Any, env: Any = "highway-fast", **options: Any) -> Result:
    """Drive a policy, or several, with and without the shield on the same seeds.

    Parameters
    ----------
    policy, env : as in `Experiment`.
    options : other attributes of `Experiment`.

    Returns
    -------
    The episodes, with their tables and pictures.

    Raises
    ------
    ConfigError, PolicyError
        For a reason of `Experiment` or its `run`.

    Examples
    --------
    >>> result = evaluate("faster", "highway-fast", episodes=2, config="worst-case")
    >>> result.summary["crash_rate"].tolist()
    [1.0, 0.0]
    """
    progress = bool(options.pop("progress", False))
    return Experiment(policy, env).with_options(**options).run(progress)


def compare(*results: Result | pd.DataFrame) -> pd.DataFrame:
    """Each shielded row of some results against the unshielded one, paired by seed.

    Parameters
    ----------
    results : results of `evaluate`, or tables of episodes.

    Returns
    -------
    The table of `evaluation.measuring.metrics.compare`.

    Raises
    ------
    ConfigError
        If there is no result, or an episode is in two of them.
    """
    if not results:
        raise ConfigError("nothing to compare: no results")
    frames = [each.episodes if isinstance(each, Result) else each for each in results]
    return metrics.compare(pd.concat(frames, ignore_index=True))
