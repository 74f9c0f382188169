"""OSQP for the filter's quadratic programs in sparse form: one workspace each, updated in place, started warm.

OSQP gets `ROUND` iterations at a time. After each, `SparseProgram.judge` eliminates the states and says how far the
answer is from optimal in the units that DAQP's answers are judged in; OSQP's own status and tolerances are not used.
Rows that miss the bound that they should hold then hold on `_FIRMER` times harder: an adaptive rho for each row, at an
interval of iterations. `max_iter` is the deadline, and nothing depends on the clock.

What OSQP does wrong silently is kept from it or found out: NaN in its data comes back as *solved* and poisons the
workspace; bounds in the wrong order are refused on stderr only, and the old data solved; where it believes that there
is no solution, it returns NaN or 1e9. So the data are checked before, the answer after, and a workspace that has raised
or has answered nonsense is thrown away, with the warm start.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from dynamics.state import FloatArray
from mpc.filter.problem import FilterSettings
from mpc.filter.program.sparse import SparseProgram
from mpc.filter.solvers.daqp import FAILED, GREATEST, Answer
from mpc.filter.solvers.warm_start import WarmStart

__all__ = ["ROUND", "OsqpSolver"]

ROUND = 15
"""Iterations between two looks at the answer."""
_RHO = 0.03
"""How hard a row of weight 1 holds on."""
_FIRMER, _FIRMEST = 4.0, 1e3
"""Factor for a row that misses its bound, each time and all together."""
_STATIONARY, _FIRST, _GAP = 0.05, 5e-3, 1e-3
"""Gradient of the Lagrangian by all inputs and by the first one, and gap, up to which an answer is exact. A first input
that is half a range away costs 1, so that it is exact to a quarter of `_FIRST` of the range."""


class OsqpSolver:
    """OSQP on the sparse programs.

    Parameters
    ----------
    settings : accuracy and the limit of iterations.

    Attributes
    ----------
    iterations : made for the last program.
    """

    def __init__(self, settings: FilterSettings) -> None:
        self.settings = settings
        self.iterations = 0
        self._warm = WarmStart(settings)
        self._slots: dict[int, _Slot] = {}

    def reset(self) -> None:
        """Forget the workspaces and what they would start from."""
        self._slots = {}
        self._warm.forget()

    def begin(self, frames: int | None) -> None:
        """A new descent: the last answer is so many frames old, or (None) has nothing to do with it."""
        if frames is None:
            self._warm.forget()
        else:
            self._warm.shift(frames)

    def prepare(self, program: SparseProgram) -> None:
        """Set up a workspace ahead of the first use."""
        self._slots[id(program)] = _Slot(program)

    def solve(self, program: SparseProgram) -> Answer:
        """From the last answer. Never raises; what the deadline cuts off is handed on as not `exact`."""
        self.iterations = 0
        if not _sane(program):
            return FAILED
        try:
            if id(program) not in self._slots:
                self.prepare(program)
            answer = self._iterate(self._slots[id(program)], program)
        except Exception:  # whatever a solver raises, the answer is that there is none
            answer = FAILED
        if answer.x is None:
            self.reset()
        return answer

    def _iterate(self, slot: _Slot, program: SparseProgram) -> Answer:
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
        return Answer(program.inputs_and_slack.copy(), primal, dual, active, exact)


class _Slot:
    """OSQP's workspace for one program, which it keeps alive so that the id stays its own."""

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
        """The program as it is now, to be started from there."""
        self._firmness[:] = 1.0
        self._update(x, y)

    def hold_firmer(self, missing: Any, x: FloatArray, y: FloatArray) -> None:
        """Those rows, the dynamics not counted (n,), hold on harder from here on."""
        which = self._firmness[-missing.size :]
        which[missing] = np.minimum(which[missing] * _FIRMER, _FIRMEST)
        self._update(x, y)

    def go_on(self) -> tuple[FloatArray, FloatArray]:
        """Another `ROUND` iterations: unknowns and multipliers."""
        found = self._object.solve(raise_error=False)
        return np.array(found.x, dtype=float), np.asarray(found.y * self._firmness)

    def _update(self, x: FloatArray, y: FloatArray) -> None:
        p, by = self._program, self._firmness
        # OSQP writes into the arrays that it is given: they are copies.
        self._object.update(Px=p.P.copy(), Ax=p.A * by[self._rows], q=p.q.copy(), l=p.l * by, u=p.u * by)
        self._object.warm_start(x=x, y=y / by)


def _sane(program: SparseProgram) -> bool:
    """Finite data and ordered bounds; NaN fails every comparison."""
    total = program.q.sum() + program.A.sum() + program.P.sum() + program.hold.sum()
    return bool(np.isfinite(total) and (program.l <= program.u).all())
