"""OSQP behind the filter: one object, updated in place, its answers never taken on trust.

What is guarded against, each seen with OSQP 1.1: a NaN in q or A comes back as *solved* and stays in the object;
an infeasible program returns finite numbers of 2e9; `lower > upper` is refused on stderr only, with the old data
kept and *solved* reported; an update of A writes into the caller's array. So: data are checked before they go in, A
goes in as a copy, residuals are computed here from the data that were asked for, and an object that misbehaves is
thrown away.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import osqp

from dynamics.state import FloatArray
from mpc.build import Program
from mpc.problem import FilterSettings

__all__ = ["Answer", "OsqpBackend"]

_GREATEST = 1e6
"""No scaled unknown of a sane program is larger."""


@dataclass(frozen=True, slots=True)
class Answer:
    """Solution of one quadratic program.

    Attributes
    ----------
    x, y : primal (deviations, scaled) and dual solution; None where there is none.
    primal, dual : greatest residuals of feasibility and of stationarity.
    iterations : made.
    state : "solved", "inaccurate", "iterations", "time" or "failed".
    """

    x: FloatArray | None
    y: FloatArray | None
    primal: float
    dual: float
    iterations: int
    state: str


class OsqpBackend:
    """Owns the OSQP object and its warm start.

    Parameters
    ----------
    settings : tolerances and limits.
    """

    def __init__(self, settings: FilterSettings) -> None:
        self.settings = settings
        self._solver: Any = None
        self._pattern: tuple[int, int, int, int] | None = None
        self.rebuilt = 0

    def reset(self) -> None:
        """Forget the object, its warm start and its step size."""
        self._solver = None

    def solve(self, program: Program, x: FloatArray | None, y: FloatArray | None, time_limit: float) -> Answer:
        """Solve; `x`, `y` warm-start it, None starts cold."""
        if not _sane(program):
            return Answer(None, None, np.inf, np.inf, 0, "failed")
        try:
            answer = self._attempt(program, x, y, time_limit)
        except Exception:  # whatever a solver raises, the answer is that there is none
            answer = Answer(None, None, np.inf, np.inf, 0, "failed")
        if answer.x is None:
            self.reset()
            self.rebuilt += 1
        return answer

    def _attempt(self, program: Program, x: FloatArray | None, y: FloatArray | None, time_limit: float) -> Answer:
        rows, columns = program.A.shape
        if self._solver is None or self._pattern != (rows, columns, program.A.nnz, program.P.nnz):
            self._setup(program)
        else:
            self._solver.update(
                Px=program.P.data.copy(), Ax=program.A.data.copy(), q=program.q, l=program.lower, u=program.upper
            )
        if time_limit > 0:
            self._solver.update_settings(time_limit=time_limit)
        self._solver.warm_start(x=np.zeros(columns) if x is None else x, y=np.zeros(rows) if y is None else y)
        found = self._solver.solve(raise_error=False)
        status = osqp.SolverStatus
        states = {
            status.OSQP_SOLVED: "solved",
            status.OSQP_SOLVED_INACCURATE: "inaccurate",
            status.OSQP_MAX_ITER_REACHED: "iterations",
            status.OSQP_TIME_LIMIT_REACHED: "time",
        }
        state = states.get(found.info.status_val, "failed")
        primal, dual = residuals(program, found.x, found.y)
        limit = 10 * self.settings.accuracy
        if not np.isfinite(primal + dual) or np.abs(found.x).max() > _GREATEST:
            return Answer(None, None, np.inf, np.inf, int(found.info.iter), "failed")
        if state == "failed":
            return Answer(None, None, primal, dual, int(found.info.iter), "failed")
        if state == "solved" and not (primal < limit * _size(program.A @ found.x) and dual < limit * _size(program.q)):
            return Answer(None, None, primal, dual, int(found.info.iter), "failed")
        return Answer(np.array(found.x), np.array(found.y), primal, dual, int(found.info.iter), state)

    def _setup(self, program: Program) -> None:
        accuracy = self.settings.accuracy
        self._solver = osqp.OSQP()
        self._solver.setup(
            program.P.copy(),
            program.q.copy(),
            program.A.copy(),
            program.lower.copy(),
            program.upper.copy(),
            verbose=False,
            eps_abs=accuracy,
            eps_rel=accuracy,
            max_iter=self.settings.max_iter,
            scaling=2,
            check_dualgap=False,
            check_termination=10,
            adaptive_rho=1,
            adaptive_rho_interval=20,
            polishing=False,
        )
        self._pattern = (*program.A.shape, program.A.nnz, program.P.nnz)


def residuals(program: Program, x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Greatest violation of the rows, and of P x + q + A' y = 0, in the program's own units."""
    p = program.P
    ax = program.A @ x
    primal = np.maximum(program.lower - ax, ax - program.upper).max()
    dual = np.abs(p @ x + p.T @ x - p.diagonal() * x + program.q + program.A.T @ y).max()
    return max(float(primal), 0.0), float(dual)


def _sane(program: Program) -> bool:
    """Finite data and ordered bounds; NaN fails every comparison."""
    total = program.q.sum() + program.A.data.sum() + program.P.data.sum() + program.lower.sum() + program.upper.sum()
    return bool(np.isfinite(total) and np.all(program.lower <= program.upper))


def _size(values: FloatArray) -> float:
    return 1.0 + float(np.abs(values).max())
