"""OSQP for the filter's quadratic programs: the second backend, slower than DAQP and independent of it.

One solver object per program, updated in place, started from the last multipliers, polished. OSQP's own status is not
trusted: NaN in its data comes back as *solved* and poisons the object, an infeasible program as finite numbers beyond
1e9, bounds in the wrong order as the old program's solution. So the data are checked before, the residuals after, and
an object that has raised or has failed is thrown away.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from dynamics.state import FloatArray
from mpc.filter.build import Program
from mpc.filter.daqp_solver import FAILED, GREATEST, Answer, residuals, sane
from mpc.filter.problem import FilterSettings

__all__ = ["OsqpSolver"]

_INFINITY = 1e30
_PER_ITERATION = 20
"""Iterations of OSQP, a matrix-vector product each, for one of an active-set method."""


class OsqpSolver:
    """OSQP on the condensed programs.

    Parameters
    ----------
    settings : accuracy, and the iteration limit (20 of OSQP's for each).
    """

    def __init__(self, settings: FilterSettings) -> None:
        self.settings = settings
        self._slots: dict[int, _Slot] = {}

    def reset(self) -> None:
        """Forget the solver objects and their multipliers."""
        self._slots = {}

    def prepare(self, program: Program) -> None:
        """Set up ahead of the first use: nothing to do, OSQP needs data to be set up."""

    def solve(self, program: Program) -> Answer:
        """Never raises."""
        if not sane(program):
            return FAILED
        columns = program.A.shape[1]
        try:
            slot = self._slots.get(id(program))
            if slot is None:
                slot = self._slots[id(program)] = _Slot(program, self.settings)
            x, y = slot.solve()
        except Exception:  # whatever a solver raises, the answer is that there is none
            self.reset()
            return FAILED
        bounds, rows = y[:columns], y[columns:]
        if np.isfinite(x).all() and np.isfinite(y).all():
            primal, dual = residuals(program, x, bounds, rows)
            if primal < self.settings.accuracy and dual < self.settings.accuracy and np.abs(x).max() < GREATEST:
                return Answer(x, primal, dual, int(np.count_nonzero(np.abs(y) > 1e-9)))
        self.reset()
        return FAILED


class _Slot:
    """OSQP's object for one program, which it keeps alive so that the id stays its own."""

    def __init__(self, program: Program, settings: FilterSettings) -> None:
        import osqp

        self.program = program
        rows, columns = program.A.shape
        self._upper = np.triu(np.ones((columns, columns), dtype=bool))
        dense = sparse.csc_matrix(np.ones((rows, columns)))
        a: Any = sparse.vstack([sparse.identity(columns), dense], format="csc")
        p = sparse.csc_matrix(self._upper.astype(float))
        # Column by column: the identity's entry, then the rows.
        self._entries = np.ones((columns, rows + 1))
        p.data[:], a.data[:] = self._hessian(), self._rows()
        self._object: Any = osqp.OSQP()
        self._object.setup(
            p,
            program.g.copy(),
            a,
            *self._limits(),
            verbose=False,
            scaling=10,
            check_dualgap=False,
            adaptive_rho=1,
            adaptive_rho_interval=20,
            check_termination=10,
            eps_abs=0.2 * settings.accuracy,
            eps_rel=0.0,
            max_iter=_PER_ITERATION * settings.max_iter,
            polishing=True,
        )
        self._y = np.zeros(rows + columns)

    def solve(self) -> tuple[FloatArray, FloatArray]:
        """Solution and multipliers of the program as it is now."""
        low, high = self._limits()
        self._object.update(Px=self._hessian(), Ax=self._rows(), q=self.program.g.copy(), l=low, u=high)
        self._object.warm_start(x=np.zeros(self.program.A.shape[1]), y=self._y)
        found = self._object.solve(raise_error=False)
        x, y = np.array(found.x, dtype=float), np.array(found.y, dtype=float)
        if np.isfinite(y).all():
            self._y = y
        return x, y

    def _hessian(self) -> FloatArray:
        return np.asarray(self.program.H.T[self._upper.T])

    def _rows(self) -> FloatArray:
        self._entries[:, 1:] = self.program.A.T
        return self._entries.ravel().copy()

    def _limits(self) -> tuple[FloatArray, FloatArray]:
        p = self.program
        low = np.maximum(np.concatenate([p.low, p.lower]), -_INFINITY)
        return low, np.minimum(np.concatenate([p.high, p.upper]), _INFINITY)
