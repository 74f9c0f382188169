"""DAQP backend of the filter's quadratic programs, through CasADi, with independent checks of the solutions.

DAQP is a dual active-set method: exact to rounding, without state and parameters. Residuals of a solution are computed
here from the program's data. A solver object that has raised an error is discarded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import casadi as ca
import numpy as np

from dynamics.state import FloatArray
from mpc.filter.problem import FilterSettings
from mpc.filter.program.condensed import Program
from mpc.filter.program.question import bind

__all__ = ["FAILED", "GREATEST", "QpSolution", "QuadraticSolver", "Solver", "residuals", "sane"]

ProgramType = TypeVar("ProgramType", contravariant=True)

GREATEST = 1e6
"""Largest magnitude of an unknown in a valid solution."""


@dataclass(frozen=True, slots=True)
class QpSolution:
    """Solution of one quadratic program.

    Attributes
    ----------
    x : unknowns; None without a solution.
    primal, dual : greatest residuals of feasibility and of stationarity.
    active : number of active bounds and rows.
    exact : whether the residuals are within the accuracy. An inexact step may be tried, but does not end the descent.
    """

    x: FloatArray | None
    primal: float
    dual: float
    active: int
    exact: bool = True


FAILED = QpSolution(None, np.inf, np.inf, 0)
"""Result without a solution."""


class QuadraticSolver(Protocol[ProgramType]):
    """Solver of quadratic programs in one form, called for one program after the other."""

    def prepare(self, program: ProgramType) -> None:
        """Compile in advance."""
        ...

    def begin(self, frames: int | None) -> None:
        """Start a new descent; the last solution is `frames` frames old, or unrelated (None)."""
        ...

    def solve(self, program: ProgramType) -> QpSolution:
        """Solve the program; never raises an error."""
        ...

    def reset(self) -> None:
        """Forget all state."""
        ...


class Solver:
    """DAQP through CasADi, compiled once for each program.

    Parameters
    ----------
    settings : accuracy and iteration limit.
    """

    def __init__(self, settings: FilterSettings) -> None:
        self.settings = settings
        self._slots: dict[int, _DaqpWorkspace] = {}

    def reset(self) -> None:
        """Forget the compiled solvers."""
        self._slots = {}

    def prepare(self, program: Program) -> None:
        """Compile in advance."""
        self._slots[id(program)] = self._compile(program)

    def begin(self, frames: int | None) -> None:
        """Nothing to do, because DAQP has no warm start."""

    def solve(self, program: Program) -> QpSolution:
        """Solve the program without a warm start."""
        if not sane(program):
            return FAILED
        try:
            if id(program) not in self._slots:
                self.prepare(program)
            slot = self._slots[id(program)]
            slot.x[:] = np.nan
            slot.call()
        except Exception:  # any error of a solver means that there is no solution
            self.reset()
            return FAILED
        primal, dual = residuals(program, slot.x, slot.bounds, slot.rows)
        limit = self.settings.accuracy
        if not (primal < limit and dual < limit and np.abs(slot.x).max() < GREATEST):
            return FAILED
        return QpSolution(slot.x.copy(), primal, dual, int(np.count_nonzero(slot.bounds) + np.count_nonzero(slot.rows)))

    def _compile(self, program: Program) -> _DaqpWorkspace:
        rows, columns = program.A.shape
        shapes = {"h": ca.Sparsity.dense(columns, columns), "a": ca.Sparsity.dense(rows, columns)}
        daqp = {"iter_limit": self.settings.most_iterations, "primal_tol": 1e-9}
        options: Any = {"error_on_fail": False, "daqp": daqp}
        solver = ca.conic("qp", "daqp", shapes, options)
        x, bounds, multipliers, cost = np.zeros(columns), np.zeros(columns), np.zeros(rows), np.zeros(1)
        names = {"h": program.H, "g": program.g, "a": program.A, "lba": program.lower, "uba": program.upper}
        names |= {"lbx": program.low, "ubx": program.high, "x0": np.zeros(columns)}
        names |= {"lam_x0": np.zeros(columns), "lam_a0": np.zeros(rows), "q": np.zeros(0), "p": np.zeros(0)}
        found = {"x": x, "cost": cost, "lam_a": multipliers, "lam_x": bounds}
        call = bind(solver, tuple(names[n] for n in solver.name_in()), tuple(found[n] for n in solver.name_out()))
        return _DaqpWorkspace(program, call, x, bounds, multipliers)


@dataclass(frozen=True, slots=True)
class _DaqpWorkspace:
    """A compiled solver bound to its program; the reference keeps the program's id unique."""

    program: Program
    call: Callable[[], None]
    x: FloatArray
    bounds: FloatArray
    rows: FloatArray


def residuals(program: Program, x: FloatArray, bounds: FloatArray, rows: FloatArray) -> tuple[float, float]:
    """Greatest violation of bounds and rows, and of H x + g + bounds + A' rows = 0 (their multipliers)."""
    ax = program.A @ x
    outside = np.maximum(program.lower - ax, ax - program.upper).max()
    beyond = np.maximum(program.low - x, x - program.high).max()
    dual = np.abs(program.H @ x + program.g + bounds + rows @ program.A).max()
    return float(np.maximum(np.maximum(outside, beyond), 0.0)), float(dual)


def sane(program: Program) -> bool:
    """Whether data are finite and bounds ordered; NaN fails every comparison."""
    total = program.g.sum() + program.A.sum() + program.H.sum()
    ordered = (program.lower <= program.upper).all() and (program.low <= program.high).all()
    return bool(np.isfinite(total) and ordered)
