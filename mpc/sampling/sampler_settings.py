"""Settings of a sampling planner, with named presets: the notebook's, iCEM, and several restarts of iCEM."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

from dynamics.errors import ConfigError
from mpc.sampling.plan import Grid

__all__ = ["PlannerSettings"]


@dataclass(frozen=True, slots=True)
class PlannerSettings:
    """Settings of a planner's search.

    Attributes
    ----------
    blocks, hold : inputs in a plan, and decisions of each.
    look : decisions between evaluated states; `hold` is a multiple of it. None for `hold`.
    fine : number of blocks with this resolution; in later ones only the last state is evaluated. None for all.
    iterations, restarts : see `mpc.sampling.cem`.
    samples : samples of each restart in the first iteration.
    decay : ratio of the samples of an iteration to those of the next, >= 1.
    elites : elites of each restart.
    std, min_std : initial and least deviation, in half ranges of the inputs.
    colour : exponent of the noise's spectrum over the blocks; 0 is white.
    momentum : share of the old distribution in the new one.
    keep : share of the elites that stay among the next samples, also from decision to decision.
    warm : whether the next search starts from the last plan.
    time_limit : greatest time of a search [s]; an iteration that would probably exceed it does not begin. None for no
        limit. With a limit, plans depend on the machine.
    answer : "best" for the cheapest sampled plan, or "mean" for the mean of the last distribution of the restart with
        the cheapest plan. With an inaccurate model the best sample may exploit the model's error.
    seed : seed of the planner's own random numbers.
    """

    blocks: int = 5
    hold: int = 5
    look: int | None = None
    fine: int | None = None
    iterations: int = 5
    restarts: int = 1
    samples: int = 100
    decay: float = 1.0
    elites: int = 10
    std: float = 1.0
    min_std: float = 0.0
    colour: float = 0.0
    momentum: float = 0.0
    keep: float = 0.0
    warm: bool = False
    time_limit: float | None = None
    answer: Literal["best", "mean"] = "best"
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("blocks", "hold", "iterations", "restarts", "elites"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} must be at least 1, got {getattr(self, name)!r}")
        if self.samples < self.elites or self.samples < 2:
            raise ConfigError(f"samples must be at least elites and 2, got {self.samples!r} for {self.elites} elites")
        if self.grid.look < 1 or self.hold % self.grid.look or not 0 <= self.grid.fine <= self.blocks:
            raise ConfigError(
                f"look must divide hold = {self.hold} and fine be at most blocks = {self.blocks}, got {self.look!r} "
                f"and {self.fine!r}"
            )
        if not (self.decay >= 1 and self.std > 0 and self.min_std >= 0 and self.colour >= 0):
            raise ConfigError("decay must be at least 1, std positive, min_std and colour at least 0")
        if not (0 <= self.momentum < 1 and 0 <= self.keep <= 1):
            raise ConfigError("momentum must be in [0, 1) and keep in [0, 1]")
        if self.answer not in ("best", "mean"):
            raise ConfigError(f"answer must be 'best' or 'mean', got {self.answer!r}")
        if self.time_limit is not None and not self.time_limit > 0:
            raise ConfigError(f"time_limit must be positive [s] or None, got {self.time_limit!r}")

    @property
    def grid(self) -> Grid:
        """Selection of the evaluated states of a plan."""
        fine = self.blocks if self.fine is None else self.fine
        return Grid(self.hold, self.hold if self.look is None else self.look, fine)

    @property
    def kept(self) -> int:
        """Number of elites that stay among the samples."""
        return round(self.keep * self.elites)

    def sizes(self) -> list[int]:
        """New samples of a restart in each iteration, at least twice the elites except where `samples` is less."""
        least = min(2 * self.elites, self.samples)
        return [max(least, round(self.samples * self.decay**-i)) for i in range(self.iterations)]

    def replace(self, **changes: Any) -> PlannerSettings:
        """A copy with some values changed."""
        return replace(self, **changes)

    @classmethod
    def notebook(cls, **changes: Any) -> PlannerSettings:
        """highway-env's parking notebook: plain CEM, 5 x 100 samples, 10 elites, 5 blocks of 5 decisions."""
        return cls().replace(**changes)

    @classmethod
    def icem(cls, **changes: Any) -> PlannerSettings:
        """One restart of iCEM."""
        improved = cls(
            std=0.7, min_std=0.05, colour=1.0, momentum=0.1, keep=0.3, warm=True, samples=64, elites=8, decay=1.25
        )
        return improved.replace(**changes)

    @classmethod
    def multistart(cls, **changes: Any) -> PlannerSettings:
        """Several restarts of iCEM."""
        return cls.icem(restarts=4, samples=32, elites=5).replace(**changes)

    @classmethod
    def mppi(cls, **changes: Any) -> PlannerSettings:
        """Settings for `mpc.sampling.mppi.MPPI`: the samples of all restarts of `multistart`, around the last plan."""
        improved = cls(std=0.5, colour=1.0, warm=True, iterations=4, samples=128, elites=128, answer="mean")
        return improved.replace(**changes)
