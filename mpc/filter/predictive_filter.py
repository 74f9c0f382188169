"""The predictive safety filter: inputs nearest to a proposal whose plan keeps its distance, the road, and can stop.

>>> import numpy as np
>>> from mpc.filter.problem import FilterProblem, FilterSettings
>>> leader = np.zeros((20, 1, 4))
>>> leader[:, 0] = [30.0, 35.0, -1.0, 1.0]  # standing 30 m ahead: s_min, s_max, r_min, r_max
>>> problem = FilterProblem(
...     state=np.array([0.0, 0.0, 0.0, 10.0]),
...     proposal=np.array([5.0, 0.0]),
...     occupancy=leader,
...     half=(4.5, 1.3),
...     edges=(-2.0, 2.0),
... )
>>> result = PredictiveFilter(FilterSettings()).solve(problem)
>>> result.status.name, bool(result.states[:, 0].max() + 4.5 < 30.1)
('SOLVED', True)
"""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from dynamics.errors import ConfigError
from dynamics.state import FloatArray
from mpc.filter.problem import FilterProblem, FilterSettings, readable
from mpc.filter.program.condensed import Program
from mpc.filter.program.question import ProblemArrays
from mpc.filter.program.road_step import StageModel
from mpc.filter.program.sparse import SparseProgram
from mpc.filter.result import FilterResult, Status
from mpc.filter.solvers.daqp import QuadraticSolver, Solver
from mpc.filter.solvers.descent import Descent, descend
from mpc.filter.solvers.guess import brake_guess, braking_function, shifted
from mpc.filter.solvers.osqp import OsqpSolver

__all__ = ["PredictiveFilter"]

_BACKENDS: dict[str, tuple[Any, Any]] = {"daqp": (Program, Solver), "osqp": (SparseProgram, OsqpSolver)}
"""Form of the program and solver of each backend."""


class PredictiveFilter:
    """Predictive filter, with its compiled programs, solver and last plan. Two filters share no state.

    Parameters
    ----------
    settings : settings of the filter, which never change.
    model : dynamics model of the plans, such as `dynamics.learned.models.casadi_steps.LearnedStep`; highway-env's
        bicycle by default. All values of a result come from this model; the braking guess always uses the bicycle.

    Raises
    ------
    ConfigError
        If `settings` has another type, or the model does not support the stages of the settings.
    """

    def __init__(self, settings: FilterSettings | None = None, model: StageModel | None = None) -> None:
        settings = FilterSettings() if settings is None else settings
        if not isinstance(settings, FilterSettings):
            raise ConfigError(f"settings must be FilterSettings, got {type(settings).__name__}")
        self.settings, self.model = settings, model
        self._form, solver = _BACKENDS[settings.backend]
        self._solver: QuadraticSolver[Any] = solver(settings)
        self._programs: dict[tuple[int, bool, bool], ProblemArrays] = {}
        self._plan: FloatArray | None = None
        self._program(settings.obstacles, False, False)

    def __reduce__(self) -> tuple[type[PredictiveFilter], tuple[FilterSettings, StageModel | None]]:
        """Copies and pickles are new filters, without compiled programs and solvers."""
        return type(self), (self.settings, self.model)

    def reset(self) -> None:
        """Forget the last plan and the solver's warm start, so that the next result is that of a new filter."""
        self._plan = None
        self._solver.begin(None)

    def prepare(self, obstacles: int, curved: bool = False) -> None:
        """Compile the programs for up to that many obstacles in advance."""
        for count in range(obstacles + 1):
            self._program(count, curved, False)
        braking_function(self.settings)

    def solve(
        self, problem: FilterProblem, guess: FloatArray | None = None, elapsed: int | None = None
    ) -> FilterResult:
        """Find the plan nearest to the proposal.

        Parameters
        ----------
        problem : the problem, in the road frame.
        guess : inputs of the first linearisation and choice of sides, (N, 2). By default the last plan, shifted, or
            else the proposal for one stage and then full braking. If a guess leads to no usable plan, braking is tried
            too.
        elapsed : frames since the last call, for the shift; the first stage by default.

        Returns
        -------
        The result; `status` contains the advice for its use. Values of any kind, including NaN, raise no error.

        Raises
        ------
        ConfigError
            If the number of stages differs from the settings, or the guess has another shape.
        """
        start = perf_counter()
        settings = self.settings
        if problem.stages != settings.stages:
            raise ConfigError(f"occupancy covers {problem.stages} stages; this filter has {settings.stages}")
        if guess is not None and np.shape(guess) != (settings.stages, 2):
            raise ConfigError(f"guess must have shape {(settings.stages, 2)}, got {np.shape(guess)}")
        if not readable(problem, guess):
            self.reset()
            return _nothing(Status.BAD_INPUT, problem, perf_counter() - start)
        deadline = start + settings.time_limit if settings.time_limit > 0 else np.inf
        try:
            best, restarted = self._search(problem, guess, elapsed, deadline)
        except (ArithmeticError, RuntimeError, ValueError):  # fail closed: the caller has a plan of its own
            self._discard()
            return _nothing(Status.ERROR, problem, perf_counter() - start)
        built = perf_counter() - start - best.solved
        if best.status is Status.ERROR or not np.isfinite(best.violation):
            self._discard()
            return _nothing(best.status, problem, built, best)
        self._plan = best.guess
        return FilterResult(
            best.status,
            best.inputs.copy(),
            best.states,
            best.sides[:, : problem.occupancy.shape[1]].astype(np.int64),
            best.slack,
            best.violation,
            best.change,
            best.primal,
            best.dual,
            best.active,
            best.sweeps,
            restarted,
            built,
            best.solved,
        )

    def _discard(self) -> None:
        """Discard the solver's objects and the plan."""
        self._solver.reset()
        self.reset()

    def _search(
        self, problem: FilterProblem, guess: FloatArray | None, elapsed: int | None, deadline: float
    ) -> tuple[Descent, bool]:
        settings = self.settings
        curved = problem.curvature is not None and bool(np.any(problem.curvature))
        program = self._program(int(problem.occupancy.shape[1]), curved, problem.reference is not None)
        program.fill(problem, settings)
        frames = settings.frames[0] if elapsed is None else elapsed
        if guess is None and self._plan is not None:
            guess = shifted(self._plan, frames, settings)
        self._solver.begin(frames if self._plan is not None else None)
        if guess is None:
            return descend(program, self._solver, brake_guess(problem, settings), deadline), False
        first = descend(program, self._solver, guess, deadline)
        if first.status.usable or perf_counter() >= deadline:
            return first, False
        # The braking guess may choose other sides.
        self._solver.begin(None)
        second = descend(program, self._solver, brake_guess(problem, settings), deadline)
        best = second if second.rank < first.rank else first
        work = {name: getattr(first, name) + getattr(second, name) for name in ("active", "sweeps", "solved")}
        return replace(best, **work), True

    def _program(self, obstacles: int, curved: bool, aimed: bool) -> ProblemArrays:
        """The compiled program for at least that many obstacles."""
        capacity = max(self.settings.obstacles, 1)
        while capacity < obstacles:
            capacity *= 2
        key = (capacity, curved, aimed)
        if key not in self._programs:
            self._programs[key] = self._form(self.settings, *key, self.model)
            self._solver.prepare(self._programs[key])
        return self._programs[key]


def _nothing(status: Status, problem: FilterProblem, built: float, descent: Descent | None = None) -> FilterResult:
    n, m = problem.stages, int(problem.occupancy.shape[1])
    inf = float("inf")
    active, sweeps, solved = (descent.active, descent.sweeps, descent.solved) if descent is not None else (0, 0, 0.0)
    return FilterResult(
        status,
        np.full((n, 2), np.nan),
        np.full((n, 4), np.nan),
        np.full((n, m), -1),
        inf,
        inf,
        inf,
        inf,
        inf,
        active,
        sweeps,
        False,
        built,
        solved,
    )
