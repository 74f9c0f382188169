"""The predictive safety filter: the nearest inputs to a proposal that keep clear, on the road and able to stop.

>>> import numpy as np
>>> from mpc.problem import FilterProblem, FilterSettings
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

from time import perf_counter
from typing import Any, Protocol

import numpy as np

from dynamics.errors import ConfigError
from dynamics.state import FloatArray, RoadState
from mpc.build import COLUMNS, Program
from mpc.guess import brake_guess, shifted
from mpc.osqp_backend import Answer, OsqpBackend
from mpc.problem import MOST_OBSTACLES, FilterProblem, FilterSettings
from mpc.result import FilterResult, Status

__all__ = ["PredictiveFilter"]


class Backend(Protocol):
    """Solves the quadratic programs."""

    def solve(self, program: Program, x: FloatArray | None, y: FloatArray | None, time_limit: float) -> Answer: ...

    def reset(self) -> None: ...


class PredictiveFilter:
    """Owns the compiled programs, the solver and the last plan. Two filters share no state.

    Parameters
    ----------
    settings : fixed for the filter's life.

    Raises
    ------
    ConfigError
        If `settings` is none.
    """

    def __init__(self, settings: FilterSettings | None = None) -> None:
        settings = FilterSettings() if settings is None else settings
        if not isinstance(settings, FilterSettings):
            raise ConfigError(f"settings must be FilterSettings, got {type(settings).__name__}")
        self.settings = settings
        self._backend: Backend = OsqpBackend(settings)
        self._programs: dict[tuple[int, bool], Program] = {}
        self._plan: FloatArray | None = None
        self._dual: FloatArray | None = None
        self._program(settings.obstacles, False)

    def __reduce__(self) -> tuple[type[PredictiveFilter], tuple[FilterSettings]]:
        """Copies and pickles start fresh: compiled programs and solvers do not travel."""
        return type(self), (self.settings,)

    def reset(self) -> None:
        """Forget the last plan and the solver's warm start: the next answer is that of a new filter."""
        self._plan = self._dual = None
        self._backend.reset()

    def solve(
        self, problem: FilterProblem, guess: FloatArray | None = None, elapsed: int | None = None
    ) -> FilterResult:
        """The nearest plan.

        Parameters
        ----------
        problem : what is asked, in the road frame.
        guess : inputs to linearise about and to take the sides from, (N, 2); by default the last plan, shifted, or
            else the proposal for one stage and then full braking.
        elapsed : frames since the last call, for the shift; one stage by default.

        Returns
        -------
        The result; `status` says what to do with it. Nothing is raised for values, however broken.

        Raises
        ------
        ConfigError
            If the number of stages is not the settings'.
        """
        start = perf_counter()
        settings = self.settings
        if problem.stages != settings.stages:
            raise ConfigError(f"occupancy covers {problem.stages} stages; this filter has {settings.stages}")
        if guess is not None and np.shape(guess) != (settings.stages, 2):
            raise ConfigError(f"guess must have shape {(settings.stages, 2)}, got {np.shape(guess)}")
        if not _readable(problem, guess):
            self.reset()
            return _nothing(Status.BAD_INPUT, problem, perf_counter() - start)
        curved = problem.curvature is not None and bool(np.any(problem.curvature))
        program = self._program(int(problem.occupancy.shape[1]), curved)
        program.fill(problem, settings)
        frames = settings.substeps if elapsed is None else max(int(elapsed), 0)
        if guess is not None:
            program.inputs[:] = guess
        elif self._plan is not None:
            program.inputs[:] = shifted(self._plan, frames, settings.substeps)
        else:
            program.inputs[:] = brake_guess(problem, settings)
        low, high = program.limits
        np.clip(program.inputs, low, high, out=program.inputs)
        dual = None
        if guess is None and self._dual is not None and frames % settings.substeps == 0:
            dual = _shift_dual(self._dual, frames // settings.substeps, settings.stages)
        return self._sweep(problem, program, dual, start)

    def _sweep(self, problem: FilterProblem, program: Program, dual: FloatArray | None, start: float) -> FilterResult:
        settings = self.settings
        low, high = program.limits
        scale = np.array([0.5 * (settings.acceleration[1] - settings.acceleration[0]), settings.steering])
        program.call()
        built, solved = perf_counter() - start, 0.0
        iterations, sweeps, change, answer = 0, 0, np.inf, None
        while sweeps < settings.sweeps:
            left = 0.0
            if settings.time_limit > 0:
                left = settings.time_limit - (perf_counter() - start)
                if left <= 0:
                    break
            mark = perf_counter()
            answer = self._backend.solve(program, None, dual, left)
            after = perf_counter()
            solved += after - mark
            iterations += answer.iterations
            sweeps += 1
            if answer.x is None or answer.y is None:
                self.reset()
                return _nothing(Status.ERROR, problem, built, solved, iterations, sweeps)
            step = answer.x.reshape(settings.stages, COLUMNS)
            before = program.inputs[0].copy()
            program.inputs += step[:, :2] * scale
            np.clip(program.inputs, low, high, out=program.inputs)
            dual, slack = answer.y, float(step[:, 6].max())
            change = float(np.abs((program.inputs[0] - before) / scale).max() / 2)
            primal, residual, state = answer.primal, answer.dual, answer.state
            program.call()
            built += perf_counter() - after
            if state == "time" or (change < settings.settled and program.violation[0] < settings.tolerance):
                break
        if answer is None:
            self.reset()
            return _nothing(Status.TIME_LIMIT, problem, built)
        violation = float(program.violation[0])
        if not (np.isfinite(program.states).all() and np.isfinite(violation)):
            self.reset()
            return _nothing(Status.ERROR, problem, built, solved, iterations, sweeps)
        self._plan, self._dual = program.inputs.copy(), dual
        return FilterResult(
            _status(state, violation, settings.tolerance),
            program.inputs.copy(),
            program.states.copy(),
            program.sides[:, : problem.occupancy.shape[1]].astype(np.int64),
            max(slack, 0.0),
            violation,
            change,
            primal,
            residual,
            iterations,
            sweeps,
            built,
            solved,
        )

    def _program(self, obstacles: int, curved: bool) -> Program:
        """The compiled program for at least that many obstacles."""
        capacity = max(self.settings.obstacles, 1)
        while capacity < obstacles:
            capacity *= 2
        key = (capacity, curved)
        if key not in self._programs:
            self._programs[key] = Program(self.settings, capacity, curved)
        return self._programs[key]


def _status(state: str, violation: float, tolerance: float) -> Status:
    if state == "time":
        return Status.TIME_LIMIT
    if violation > tolerance:
        return Status.SLACK
    return {"solved": Status.SOLVED, "inaccurate": Status.INACCURATE}.get(state, Status.MAX_ITER)


def _readable(problem: FilterProblem, guess: FloatArray | None) -> bool:
    """Whether the arithmetic will stay finite: NaN nowhere, infinity only where it stands for unbounded."""
    if problem.occupancy.shape[1] > MOST_OBSTACLES:
        return False
    finite: list[Any] = [problem.state, problem.half]
    finite += [v for v in (problem.proposal, problem.curvature, guess, problem.limits) if v is not None]
    if problem.reference is not None:
        aim = problem.reference
        finite += [aim.r, aim.v, (aim.lateral, aim.heading, aim.speed)]
        if min(aim.lateral, aim.heading, aim.speed) < 0:
            return False
    if not all(np.isfinite(v).all() for v in finite):
        return False
    open_ended: list[Any] = [problem.occupancy, *problem.edges, *problem.corridor, problem.stop]
    if problem.rest is not None:
        open_ended.append(problem.rest)
    if any(np.isnan(v).any() for v in open_ended):
        return False
    if problem.limits is not None and np.any(problem.limits[:, 0] > problem.limits[:, 1]):
        return False
    ordered = problem.occupancy[..., 0::2] <= problem.occupancy[..., 1::2]
    state = problem.state
    sane = abs(state[RoadState.SPEED]) < 200 and abs(state[RoadState.HEADING]) < 10
    return bool(ordered.all() and sane and min(problem.half) >= 0)


def _shift_dual(dual: FloatArray, stages: int, n: int) -> FloatArray:
    """Multipliers moved to the stages that they belong to now; the last stage's are repeated."""
    rows = (dual.size - 5) // n
    table = dual[: rows * n].reshape(n, rows)
    index = np.minimum(np.arange(n) + stages, n - 1)
    return np.concatenate([table[index].ravel(), dual[rows * n :]])


def _nothing(
    status: Status,
    problem: FilterProblem,
    built: float,
    solved: float = 0.0,
    iterations: int = 0,
    sweeps: int = 0,
) -> FilterResult:
    n, m = problem.stages, int(problem.occupancy.shape[1])
    inf = float("inf")
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
        iterations,
        sweeps,
        built,
        solved,
    )
