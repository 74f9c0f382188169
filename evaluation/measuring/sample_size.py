"""Number of episodes that a statement about crash rates needs."""

from __future__ import annotations

import math

from scipy import stats

from evaluation.measuring.statistics import CONFIDENCE
from shield.errors import ConfigError

__all__ = ["POWER", "episodes_to_tell_apart", "episodes_without_a_crash"]

POWER = 0.8
"""Default probability of finding an existing difference."""


def episodes_without_a_crash(rate: float, confidence: float = CONFIDENCE) -> int:
    """Number of episodes without a crash that shows a crash rate of at most `rate`.

    After them the upper end of `evaluation.measuring.statistics.clopper_pearson` is at most `rate`.

    Raises
    ------
    ConfigError
        If the rate is not between 0 and 1.

    Examples
    --------
    >>> episodes_without_a_crash(1e-3)
    2995
    """
    _check(rate)
    return math.ceil(math.log(1.0 - confidence) / math.log1p(-rate))


def episodes_to_tell_apart(one: float, other: float, confidence: float = CONFIDENCE, power: float = POWER) -> int:
    """Number of episodes of each of two policies that shows a difference of their crash rates.

    The episodes of the two are independent here; with the same seeds for both, no more are needed.
    Source: the normal approximation for two proportions, Fleiss, Levin and Paik 2003, equation 4.14.

    Raises
    ------
    ConfigError
        If a rate is not between 0 and 1, or the two are equal.

    Examples
    --------
    >>> episodes_to_tell_apart(0.3, 0.1)
    62
    """
    _check(one)
    _check(other)
    if one == other:
        raise ConfigError(f"two rates of {one:g} cannot be told apart")
    mean = 0.5 * (one + other)
    missed, found = float(stats.norm.ppf(0.5 + 0.5 * confidence)), float(stats.norm.ppf(power))
    spread = missed * math.sqrt(2 * mean * (1 - mean))
    spread += found * math.sqrt(one * (1 - one) + other * (1 - other))
    return math.ceil((spread / (one - other)) ** 2)


def _check(rate: float) -> None:
    if not 0 < rate < 1:
        raise ConfigError(f"a crash rate is between 0 and 1, both excluded; got {rate:g}")
