"""Searches an attack's numbers for the run that comes nearest to the ego, or deepest into its buffer, unflagged."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from attacks import ATTACKS, Run, play
from driven_traffic import Outcome
from scipy.optimize import differential_evolution

__all__ = ["Worst", "cost", "worst_case"]

FLAGGED, DISCARDED, FAR = 5.0, 10.0, 30.0


class _Found(Exception):
    """Ends a search at the first clean breach."""


@dataclass
class Worst:
    """The best run of a search, and how many it took."""

    run: Run
    outcome: Outcome
    evaluations: int

    def describe(self) -> str:
        return f"after {self.evaluations} runs: {self.run.describe(self.outcome)}"


def cost(out: Outcome) -> float:
    """True clearance [m]; runs that are flagged, or whose start is not verified, cost more than any that is not."""
    clearance = min(out.clearance, FAR)
    if not out.started:
        return FAR + DISCARDED + clearance
    return clearance + (FAR + FLAGGED) * out.flagged - (0.5 if out.crashed and not out.flagged else 0.0)


def worst_case(
    name: str, action: str, hz: int, *, evaluations: int = 200, seed: int = 0, population: int = 20, first: bool = True
) -> Worst:
    """Differential evolution over the numbers of an attack, among at most so many runs; up to the first clean breach
    where `first`.
    """
    attack = ATTACKS[name]
    best: Worst | None = None
    count = 0

    def objective(unit: np.ndarray) -> float:
        nonlocal best, count
        if count >= evaluations:
            raise _Found
        count += 1
        run = Run(name, action, hz, seed, tuple(float(u) for u in unit))
        out = play(run)
        if best is None or cost(out) < cost(best.outcome):
            best = Worst(run, out, count)
            if first and out.clean_breach:
                raise _Found
        return cost(out)

    rng = np.random.default_rng([seed, hz, *name.encode()])
    start = rng.random((population, attack.size))
    with suppress(_Found):
        differential_evolution(
            objective,
            [(0.0, 1.0)] * attack.size,
            init=start,
            maxiter=evaluations // population + 1,
            rng=rng,
            mutation=(0.4, 0.9),
            recombination=0.7,
            tol=0.0,
            polish=False,
        )
    assert best is not None
    best.evaluations = count
    return best
