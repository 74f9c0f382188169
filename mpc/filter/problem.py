"""Settings and problem of the predictive filter.

Notation
--------
Road frame: s [m] along, r [m] across, psi [rad], v [m/s]. There are N stages of `substeps` frames of dt [s], except the
first one of `hold` frames. Stage k = 1..N ends after `FilterSettings.ends[k - 1]` frames. Input (a, delta):
acceleration [m/s^2], front wheel angle [rad].
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from itertools import accumulate
from typing import Any

import numpy as np

from dynamics.errors import ConfigError, SceneError
from dynamics.state import FloatArray, RoadState

__all__ = ["BACKENDS", "FREE", "FilterProblem", "FilterSettings", "Occupied", "Reference", "Side", "readable"]

BACKENDS = ("daqp", "osqp")
"""Valid values of `FilterSettings.backend`."""
MOST_OBSTACLES = 96
"""Largest number of obstacles; more are bad input."""
FREE = 1e6
"""Value for an absent bound [m]. Every bound is limited to it, so that arithmetic stays finite."""


class Occupied(IntEnum):
    """Columns of an occupancy rectangle [m]."""

    S_MIN = 0
    S_MAX = 1
    R_MIN = 2
    R_MAX = 3


class Side(IntEnum):
    """Side on which the plan passes a rectangle: behind it, ahead of it, at lower r, at higher r."""

    BEHIND = 0
    AHEAD = 1
    LOW = 2
    HIGH = 3


@dataclass(frozen=True, slots=True)
class FilterSettings:
    """Settings of a filter, which never change.

    Parameters
    ----------
    dt : duration of a simulation frame [s].
    substeps : frames in a stage, which has one input.
    hold : frames in the first stage: the least time for which the first input will be executed; `substeps` by default.
        A filter that is called in every frame brakes too early if its first stage is longer than a frame.
    stages : stages in the horizon.
    obstacles : number of obstacles for which the filter is compiled at first; more are accepted (up to
        `MOST_OBSTACLES`) with another compilation.
    acceleration : least and greatest acceleration [m/s^2].
    steering : greatest front wheel angle to either side [rad].
    braking : deceleration of the stop after the horizon [m/s^2].
    smoothing : weight of the changes of later inputs, relative to 1 for the first input's deviation.
    magnitude : weight of later accelerations.
    steadiness : weight of later steering beyond the road's curvature, times 1 + (v / 5 m/s)^2. Without it, swerving is
        the cheapest way to cover less road.
    damping : weight of the changes of later steering about the guess. Without it, linearised plans oscillate from side
        to side. It vanishes as the linearisations converge.
    free_moves : number of changes of the inputs in a plan. The first belongs to the first stage alone, later ones to
        more and more stages (`moves`).
    curving : weight of the squared slack [1/m^2], which makes the programs strictly convex.
    penalty : cost of a violated constraint [1/m]; the cost of a first input half a range away is 1.
    heading : greatest heading of a plan relative to the road [rad], as a soft constraint.
    trust : greatest change of headings from those of the linearisation [rad].
    sweeps : greatest number of linearisations in one `solve`; 1 is the real-time iteration.
    settled : change of the first input below which no further linearisation is made, as a share of the range.
    tolerance : violation in the exact rollout up to which a plan counts as solved [m].
    accuracy : residuals up to which a quadratic program counts as solved [m]; the exact rollout decides in the end.
    backend : solver of the quadratic programs, "daqp" (condensed) or "osqp" (sparse); see docs/predictive-filter.md.
    max_iter : iterations of one quadratic program, a deterministic time limit; by default `most_iterations`.
    time_limit : additional limit of the wall time of one `solve` [s]; 0 for none.

    Raises
    ------
    ConfigError
        If a value is out of its range.
    """

    dt: float = 1 / 15
    substeps: int = 3
    hold: int | None = None
    stages: int = 20
    obstacles: int = 6
    acceleration: tuple[float, float] = (-5.0, 5.0)
    steering: float = float(np.pi / 4)
    braking: float = 5.0
    smoothing: float = 1e-3
    magnitude: float = 1e-3
    steadiness: float = 0.1
    damping: float = 1e-3
    free_moves: int = 8
    penalty: float = 100.0
    curving: float = 1.0
    heading: float = 0.4
    trust: float = 0.3
    sweeps: int = 3
    settled: float = 0.002
    tolerance: float = 0.05
    accuracy: float = 5e-3
    backend: str = "daqp"
    max_iter: int | None = None
    time_limit: float = 0.0

    def __post_init__(self) -> None:
        positive = (
            "dt",
            "braking",
            "smoothing",
            "magnitude",
            "penalty",
            "curving",
            "trust",
            "settled",
            "tolerance",
            "accuracy",
        )
        for name in positive:
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ConfigError(f"{name} must be positive and finite, got {value!r}")
        for name, least, most in (
            ("substeps", 1, 100),
            ("stages", 2, 200),
            ("obstacles", 0, MOST_OBSTACLES),
            ("free_moves", 1, self.stages),
            ("sweeps", 1, 50),
        ):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
                raise ConfigError(f"{name} must be an integer from {least} to {most}, got {value!r}")
        if self.max_iter is not None and (isinstance(self.max_iter, bool) or self.max_iter not in range(1, 1_000_001)):
            raise ConfigError(f"max_iter must be None or an integer from 1 to 1000000, got {self.max_iter!r}")
        if self.hold is not None and (isinstance(self.hold, bool) or self.hold not in range(1, self.substeps + 1)):
            raise ConfigError(f"hold must be None or from 1 to {self.substeps} (substeps), got {self.hold!r}")
        if self.backend not in BACKENDS:
            raise ConfigError(f"unknown backend {self.backend!r}; valid are {', '.join(BACKENDS)}")
        low, high = self.acceleration
        if not (np.isfinite(low) and np.isfinite(high) and low < 0 <= high):
            raise ConfigError(f"acceleration must be (low < 0, high >= 0) [m/s^2], got {self.acceleration!r}")
        if not 0 < self.steering <= np.pi / 3:
            raise ConfigError(f"steering must be in (0, pi/3] rad, got {self.steering!r}")
        if not (np.isfinite(self.time_limit) and self.time_limit >= 0):
            raise ConfigError(f"time_limit must be 0 (none) or positive [s], got {self.time_limit!r}")

    @property
    def stage(self) -> float:
        """Duration of a stage [s]."""
        return self.dt * self.substeps

    @property
    def most_iterations(self) -> int:
        """`max_iter`, or by default 300 active sets for DAQP and 150 iterations for OSQP."""
        return {"daqp": 300, "osqp": 150}[self.backend] if self.max_iter is None else self.max_iter

    @property
    def moves(self) -> tuple[int, ...]:
        """Number of stages of each move."""
        n, count = self.stages, self.free_moves
        ends = [max(round(n * (i / count) ** 1.8), i) for i in range(1, count)]
        return tuple(int(d) for d in np.diff([0, *ends, n]))

    @property
    def frames(self) -> tuple[int, ...]:
        """Number of frames of each stage."""
        return (self.substeps if self.hold is None else self.hold, *[self.substeps] * (self.stages - 1))

    @property
    def ends(self) -> tuple[int, ...]:
        """Number of frames from now to the end of each stage."""
        return tuple(accumulate(self.frames))

    @property
    def horizon(self) -> float:
        """Duration of the plan [s]."""
        return self.dt * self.ends[-1]


@dataclass(frozen=True, slots=True)
class Reference:
    """Target of a plan: least-squares terms, in addition to a proposal or instead of it.

    Parameters
    ----------
    r : lateral position [m], scalar or (N,).
    v : speed [m/s], scalar or (N,).
    lateral : weight [1/m^2] of r.
    heading : weight [1/rad^2] of psi.
    speed : weight [s^2/m^2] of v.
    """

    r: Any
    v: Any
    lateral: float = 0.02
    heading: float = 0.5
    speed: float = 0.01


@dataclass(frozen=True, slots=True)
class FilterProblem:
    """One problem of the filter, in the road frame.

    Parameters
    ----------
    state : (s, r, psi, v), shape (4,).
    proposal : the proposed input, shape (2,); None only with a `reference`.
    occupancy : rectangles that others may occupy at the end of each stage, columns `Occupied`, shape (N, m, 4) [m],
        not inflated; +-inf for no bound.
    half : half extents (along, across) of the ego's buffered footprint at heading zero [m].
    edges : (low, high) r, bounds of the buffered footprint [m], each scalar or (N,).
    corridor : (low, high) r, bounds of the centre [m], each scalar or (N,).
    curvature : curvature of the reference path [1/m], (N,); None on a straight road.
    rest : earliest stopping position of the rear of each obstacle [m], (m,). A plan that ends behind an obstacle must
        be able to stop behind this position. By default s_min at the end of the horizon.
    stop : s before which the front of the buffered footprint must be able to stop [m]; +inf for none.
    reference : target in addition to the proposal or instead of it.
    limits : valid inputs, rows a and delta, columns least and greatest, (2, 2); by default the settings'.

    Raises
    ------
    SceneError
        If a shape is wrong, or there is neither a proposal nor a reference. Values that are not finite raise no error
        here: `PredictiveFilter.solve` returns `Status.BAD_INPUT` for them.
    """

    state: FloatArray
    proposal: FloatArray | None
    occupancy: FloatArray
    half: tuple[float, float]
    edges: tuple[Any, Any] = (-np.inf, np.inf)
    corridor: tuple[Any, Any] = (-np.inf, np.inf)
    curvature: FloatArray | None = None
    rest: FloatArray | None = None
    stop: float = np.inf
    reference: Reference | None = None
    limits: FloatArray | None = field(default=None)

    def __post_init__(self) -> None:
        shape = np.shape(self.occupancy)
        if len(shape) != 3 or shape[2] != len(Occupied):
            raise SceneError(f"occupancy must have shape (stages, obstacles, 4), got {shape}")
        stages, m, _ = shape
        wanted: tuple[tuple[str, tuple[int, ...]], ...] = (
            ("state", (4,)),
            ("proposal", (2,)),
            ("half", (2,)),
            ("curvature", (stages,)),
            ("rest", (m,)),
            ("limits", (2, 2)),
        )
        for name, expected in wanted:
            value = getattr(self, name)
            if value is not None and np.shape(value) != expected:
                raise SceneError(f"{name} must have shape {expected}, got {np.shape(value)}")
        if self.proposal is None and self.reference is None:
            raise SceneError("a problem needs a proposal, a reference or both; both are None")

    @property
    def stages(self) -> int:
        """Number of stages of the occupancy."""
        return int(np.shape(self.occupancy)[0])


def readable(problem: FilterProblem, guess: FloatArray | None = None) -> bool:
    """Whether the arithmetic will stay finite: no NaN, and infinity only for an absent bound."""
    finite: list[Any] = [problem.state, problem.half]
    finite += [v for v in (problem.proposal, problem.curvature, guess, problem.limits) if v is not None]
    if problem.reference is not None:
        aim = problem.reference
        weights = (aim.lateral, aim.heading, aim.speed)
        finite += [aim.r, aim.v, weights]
        if not min(weights) >= 0:
            return False
    if not all(np.isfinite(v).all() for v in finite):
        return False
    occupancy = problem.occupancy
    if occupancy.shape[1] > MOST_OBSTACLES or not (occupancy[..., 0::2] <= occupancy[..., 1::2]).all():
        return False
    bounds: list[Any] = [*problem.edges, *problem.corridor, problem.stop]
    if problem.rest is not None:
        bounds.append(problem.rest)
    if any(np.isnan(v).any() for v in bounds):
        return False
    if problem.limits is not None and not (problem.limits[:, 0] <= problem.limits[:, 1]).all():
        return False
    speed, heading = problem.state[RoadState.SPEED], problem.state[RoadState.HEADING]
    return bool(abs(speed) < 200 and abs(heading) < 10 and min(problem.half) >= 0)
