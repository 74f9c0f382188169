r"""Adaptive multilevel splitting: the probability of a rare event along paths that are random in every step.

Notation
--------
A path has a score xi_t after each step. Its level is the greatest of them, S = max_t xi_t. The event is S >= b. In each
round the K paths with the lowest levels of n are dropped; Z is the highest level among these. Each dropped path copies
a surviving path up to the first step with xi_t > Z, and is drawn anew from there. With K_q dropped in round q,

    P(S >= b) = prod_q (1 - K_q / n) * (share of the last paths with S >= b)

The estimate is unbiased for every score, if all paths with the level Z are dropped together.

Sources: Cerou and Guyader 2007; Brehier, Gazeau, Goudenege, Lelievre and Rousset 2016 (levels that tie).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf, prod, sqrt

import numpy as np

from dynamics.errors import ConfigError
from dynamics.state import FloatArray

__all__ = ["Split", "SplitPath", "multilevel_splitting"]

_MOST_ROUNDS = 1000


@dataclass(frozen=True, slots=True)
class SplitPath:
    """Seeds of a path.

    Attributes
    ----------
    seed : seed of the path from its start.
    forks : pairs of a step, counted from 1, and the seed that replaces the former one from that step on.
    """

    seed: int
    forks: tuple[tuple[int, int], ...] = ()

    def fork(self, step: int, seed: int) -> SplitPath:
        """A copy that is the same before the step and uses another seed from there on."""
        return SplitPath(self.seed, (*(each for each in self.forks if each[0] < step), (step, seed)))


Drive = Callable[[Sequence[SplitPath]], Sequence[FloatArray]]
"""Function that returns the scores of each path, before the first step and after each, (steps + 1,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """Result of multilevel splitting.

    Attributes
    ----------
    probability : the estimate; 0 if all remaining paths had the same level.
    variation : coefficient of variation for independent paths, a lower bound; infinite if the event was not reached.
    evaluations : number of paths driven.
    levels : Z of each round.
    dropped : K of each round.
    paths, reached : the last paths and their levels, the highest first.
    """

    probability: float
    variation: float
    evaluations: int
    levels: tuple[float, ...]
    dropped: tuple[int, ...]
    paths: tuple[SplitPath, ...]
    reached: FloatArray


def multilevel_splitting(
    drive: Drive, event: float = 0.0, paths: int = 200, share: float = 0.1, seed: int = 0, most: int | None = None
) -> Split:
    """Estimate P(S >= b).

    Parameters
    ----------
    drive : returns the scores of paths.
    event : b.
    paths : n; the first paths have the seeds from `seed` on.
    share : share of the paths that are dropped in a round, at least one path.
    seed : seed of the random choices.
    most : number of driven paths after which no further round begins; the estimate is then that of the last level.

    Raises
    ------
    ConfigError
        If the numbers are out of range, or a score is NaN.

    Examples
    --------
    >>> def walk(paths):  # up or down by one, ten times: P(S >= 8) = 22 / 1024
    ...     return [np.cumsum([0, *steps]) for steps in map(drawn, paths)]
    >>> def drawn(path):
    ...     forks, steps = dict(path.forks), []
    ...     for k in range(1, 11):
    ...         rng = np.random.default_rng(forks.get(k, path.seed)) if k in forks or k == 1 else rng
    ...         steps.append(rng.choice([-1, 1]))
    ...     return steps
    >>> found = multilevel_splitting(walk, event=8, paths=400)
    >>> 0.01 < found.probability < 0.04
    True
    """
    if paths < 2 or not 0 < share < 1:
        raise ConfigError(f"have at least 2 paths and a share between 0 and 1, not {paths} and {share}")
    rng, ways = np.random.default_rng([seed, 0]), [SplitPath(seed + i) for i in range(paths)]
    scores, count = _drive_checked(drive, ways), max(1, round(share * paths))
    evaluations, spread, levels, dropped = paths, 0.0, list[float](), list[int]()
    while True:
        reached = np.array([each.max() for each in scores])
        level = float(np.sort(reached)[count - 1])
        out = np.flatnonzero(reached <= level)
        if level >= event or len(levels) == _MOST_ROUNDS or (most is not None and evaluations >= most):
            break
        levels.append(level)
        dropped.append(len(out))
        if len(out) == paths:
            break
        spread += len(out) / (paths * (paths - len(out)))
        for i, parent in zip(out, rng.choice(np.flatnonzero(reached > level), len(out)), strict=True):
            ways[i] = _forked(ways[parent], scores[parent], level, rng)
        for i, found in zip(out, _drive_checked(drive, [ways[i] for i in out]), strict=True):
            scores[i] = found
        evaluations += len(out)
    within = float((reached >= event).mean())
    probability = prod((1 - count / paths for count in dropped), start=1.0) * within
    variation = sqrt(spread + (1 - within) / (within * paths)) if probability > 0 else inf
    order = np.argsort(-reached, kind="stable")
    last = tuple(ways[i] for i in order)
    return Split(probability, variation, evaluations, tuple(levels), tuple(dropped), last, reached[order])


def _forked(parent: SplitPath, scores: FloatArray, level: float, rng: np.random.Generator) -> SplitPath:
    """A copy of a path with these scores up to the first step above the level, drawn anew from there on."""
    return parent.fork(int(np.argmax(scores > level)) + 1, int(rng.integers(2**32)))


def _drive_checked(drive: Drive, ways: Sequence[SplitPath]) -> list[FloatArray]:
    scores = [np.asarray(each, float) for each in drive(ways)]
    if len(scores) != len(ways) or any(each.ndim != 1 or not each.size or np.isnan(each).any() for each in scores):
        raise ConfigError("a path has one score before its first step and one after each, none of them NaN")
    return scores
