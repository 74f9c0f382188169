"""OSQP backend of the filter's quadratic programs in sparse form: one workspace each, updated in place, with warm
start.

OSQP runs `ROUND` iterations at a time. After each round, `SparseProgram.judge` eliminates the states and measures the
optimality of the solution in the same units as for DAQP. OSQP's own status and tolerances are not used. Rows that miss
their bound get a weight `_FIRMER` times larger: an adaptive rho for each row, after fixed numbers of iterations.
`max_iter` is the deadline, and nothing depends on the clock.

OSQP has silent faults. NaN in its data returns *solved* and corrupts the workspace. Bounds in the wrong order are
reported on stderr only, and the old data are solved. For problems that it takes to be infeasible it returns NaN or 1e9.
So the data are checked before, and the solution after. A workspace that has raised an error or returned an invalid
solution is discarded, with the warm start.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from dynamics.state import FloatArray
from mpc.filter.problem import FilterSettings
from mpc.filter.program.sparse import SparseProgram
from mpc.filter.solvers.daqp import FAILED, GREATEST, QpSolution
from mpc.filter.solvers.warm_start import WarmStart

__all__ = ["ROUND", "OsqpSolver"]

ROUND = 15
"""Number of iterations between two checks of the solution."""
_RHO = 0.03
"""ADMM penalty of a row with weight 1."""
_FIRMER, _FIRMEST = 4.0, 1e3
"""Factor on the weight of a row that misses its bound, for each round, and its upper limit."""
_STATIONARY, _FIRST, _GAP = 0.05, 5e-3, 1e-3
"""Largest gradient of the Lagrangian by all inputs and by the first one, and gap, of an exact solution. A first input
half a range away costs 1, so the first input is exact to a quarter of `_FIRST` of the range."""


class OsqpSolver:
    """OSQP for the sparse programs.

    Parameters
    ----------
    settings : accuracy and limit of iterations.

    Attributes
    ----------
    iterations : number of iterations for the last program.
    """

    def __init__(self, settings: FilterSettings) -> None:
        self.settings = settings
        self.iterations = 0
        self._warm = WarmStart(settings)
        self._slots: dict[int, _OsqpWorkspace] = {}

    def reset(self) -> None:
        """Forget the workspaces and the warm start."""
        self._slots = {}
        self._warm.forget()

    def begin(self, frames: int | None) -> None:
        """Start a new descent; the last solution is `frames` frames old, or unrelated (None)."""
        if frames is None:
            self._warm.forget()
        else:
            self._warm.shift(frames)

    def prepare(self, program: SparseProgram) -> None:
        """Set up a workspace in advance."""
        self._slots[id(program)] = _OsqpWorkspace(program)

    def solve(self, program: SparseProgram) -> QpSolution:
        """Solve with a warm start. Never raises an error; a solution cut off by the iteration limit is not `exact`."""
        self.iterations = 0
        if not _sane(program):
            return FAILED
        try:
            if id(program) not in self._slots:
                self.prepare(program)
            answer = self._iterate(self._slots[id(program)], program)
        except Exception:  # any error of a solver means that there is no solution
            answer = FAILED
        if answer.x is None:
            self.reset()
        return answer

    def _iterate(self, slot: _OsqpWorkspace, program: SparseProgram) -> QpSolution:
        limit = self.settings.accuracy
        slot.load(*self._warm.start(program.hold))
        while True:
            x, y = slot.go_on()
            self.iterations += ROUND
            if not (np.abs(x).max() < GREATEST and np.isfinite(y).all()):  # NaN fails the comparison
                return FAILED
            program.answer[:], program.multipliers[:] = x, y
            program.judge()
            primal, dual = float(program.primal[0]), float(program.dual[0])
            exact = primal < limit and dual < _STATIONARY and bool(program.first[0] < _FIRST and program.gap[0] < _GAP)
            if exact or self.iterations + ROUND > self.settings.most_iterations:
                break
            slot.hold_firmer(program.miss > limit, x, y)
        self._warm.keep(x, y * program.hold)
        active = int(np.count_nonzero(np.abs(y[-program.miss.size :]) > 1e-9))
        return QpSolution(program.inputs_and_slack.copy(), primal, dual, active, exact)


class _OsqpWorkspace:
    """OSQP's workspace for one program; the reference keeps the program's id unique."""

    def __init__(self, program: SparseProgram) -> None:
        import osqp

        self._program = program
        self._rows = program.patterns[1][0]
        self._firmness = np.ones(program.l.size)
        (p, a) = (
            sparse.csc_matrix((np.zeros(rows.size), rows, columns), shape=shape)
            for rows, columns, shape in program.patterns
        )
        self._object: Any = osqp.OSQP()
        self._object.setup(
            p,
            np.zeros_like(program.q),
            a,
            np.zeros_like(program.l),
            np.zeros_like(program.u),
            verbose=False,
            scaling=0,
            rho=_RHO,
            rho_is_vec=False,
            adaptive_rho=0,
            check_termination=0,
            check_dualgap=False,
            polishing=False,
            max_iter=ROUND,
        )

    def load(self, x: FloatArray, y: FloatArray) -> None:
        """Load the present program, with a warm start."""
        self._firmness[:] = 1.0
        self._update(x, y)

    def hold_firmer(self, missing: Any, x: FloatArray, y: FloatArray) -> None:
        """Increase the weights of the rows `missing` (n,), which do not include the dynamics."""
        which = self._firmness[-missing.size :]
        which[missing] = np.minimum(which[missing] * _FIRMER, _FIRMEST)
        self._update(x, y)

    def go_on(self) -> tuple[FloatArray, FloatArray]:
        """Run another `ROUND` iterations, and return unknowns and multipliers."""
        found = self._object.solve(raise_error=False)
        return np.array(found.x, dtype=float), np.asarray(found.y * self._firmness)

    def _update(self, x: FloatArray, y: FloatArray) -> None:
        p, by = self._program, self._firmness
        # OSQP writes into its input arrays, so they are copies.
        self._object.update(Px=p.P.copy(), Ax=p.A * by[self._rows], q=p.q.copy(), l=p.l * by, u=p.u * by)
        self._object.warm_start(x=x, y=y / by)


def _sane(program: SparseProgram) -> bool:
    """Whether data are finite and bounds ordered; NaN fails every comparison."""
    total = program.q.sum() + program.A.sum() + program.P.sum() + program.hold.sum()
    return bool(np.isfinite(total) and (program.l <= program.u).all())
