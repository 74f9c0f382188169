r"""The filter's quadratic program in condensed form, for DAQP, as one fused CasADi function without side effects.

The problem
-----------
With z = u / (half the range of the input), proposal z_p, road states x_k at the end of stage k:

    min  w |z_0 - z_p|^2 + smoothing sum |z_k - z_{k-1}|^2 + magnitude sum |z_k - z_ff|^2
         + reference terms in r_k, psi_k, v_k + penalty sum sigma
    s.t. x_{k+1} = F(x_k, u_k) (Euler frames, exactly; or a model)        u in its box, v_k >= 0 (see `without_reverse`)
         s_k + h_s(psi_k) <= s_min of obstacles passed behind             s_k - h_s >= s_max of obstacles passed ahead
         r_k + lat cos psi_k +- lon sin psi_k <= r_min, upper edge        the same at the lower side
         corridor_low <= r_k <= corridor_high
         s_N + h_s + v_N^2 / (2 b) <= stopping positions of obstacles that the plan ends behind, and `stop`
         r_N + v_N^2 / (2 b) sin psi_N, with the footprint, between the edges

Every constraint after the box is relaxed by a slack sigma >= 0 [m], which the stages of a move share. All obstacles
that are passed on the same side share a row with the tightest bound. So the size of the program does not depend on
their number.

The program is linearised about the rollout of guessed inputs and condensed. The unknowns are the changes of the inputs
about the guess and the slack of each move. A *move* is several stages with the same change. The guess itself may differ
from stage to stage, so a shifted plan loses nothing. Zero is always a feasible point up to slack. The change of the
heading is limited to the trust region.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from dynamics.state import FloatArray
from mpc.filter.problem import FilterProblem, FilterSettings
from mpc.filter.program.linearised import INFINITY, LEVER, linearised
from mpc.filter.program.question import ProblemArrays
from mpc.filter.program.road_step import StageModel
from mpc.filter.program.rows import Sensitivity, objective, references

__all__ = ["Program", "build"]


class Program(ProblemArrays):
    """Compiled program of one size, in condensed form.

    min 1/2 w' H w + g' w  s.t.  low <= w <= high,  lower <= A w <= upper

    Attributes
    ----------
    H, A : dense, column-major.
    g, low, high, lower, upper : the other arrays of the program.
    """

    def __init__(
        self, settings: FilterSettings, capacity: int, curved: bool, aimed: bool, model: StageModel | None = None
    ) -> None:
        function, rollout, shape = _compiled(settings, capacity, curved, aimed, model)
        rows, columns = shape
        self.H, self.A = np.zeros((columns, columns), order="F"), np.zeros((rows, columns), order="F")
        self.g, self.low, self.high = np.zeros(columns), np.zeros(columns), np.zeros(columns)
        self.lower, self.upper = np.zeros(rows), np.zeros(rows)
        program = (self.H, self.A, self.g, self.low, self.high, self.lower, self.upper)
        super().__init__(settings, capacity, function, rollout, program)


def build(
    problem: FilterProblem, inputs: FloatArray, settings: FilterSettings, model: StageModel | None = None
) -> Program:
    """The program of one problem, linearised about the rollout of `inputs` (N, 2), without a solver."""
    curved = problem.curvature is not None and bool(np.any(problem.curvature))
    program = Program(settings, max(int(problem.occupancy.shape[1]), 1), curved, problem.reference is not None, model)
    program.fill(problem, settings)
    program.inputs[:] = inputs
    program.linearise()
    return program


_OPTIONS = {"cse": True}
_HEADING = ca.SX(ca.DM([[0, 0, 1, 0]]))
_SPEED = ca.SX(ca.DM([[0, 0, 0, 1]]))
_TURNED = ca.SX(ca.DM([[0, 0, LEVER, 0], [0, 0, -LEVER, 0]]))


@lru_cache(maxsize=32)
def _compiled(
    settings: FilterSettings, m: int, curved: bool, aimed: bool, model: StageModel | None
) -> tuple[ca.Function, ca.Function, tuple[int, int]]:
    way = linearised(settings, m, curved, model)
    slope, slopes, rows = Sensitivity(settings), [], []
    lower: list[Any] = []
    upper: list[Any] = []
    k = 0
    for j, length in enumerate(settings.moves):
        for _ in range(length):
            slopes.append(slope.step(j, *way.slopes[k]))
            jacobian, to_bound = way.rows[k]
            rows.append(slope.rows(jacobian, j))
            lower.append(-INFINITY * ca.DM.ones(to_bound.shape[0]))
            upper.append(to_bound)
            k += 1
        # Speed is linear within a move, so a non-negative speed at its end is non-negative throughout.
        x = way.states[k - 1]
        rows += [slope.hard(_SPEED), slope.hard(_HEADING), slope.rows(_TURNED, j)]
        lower += [ca.fmin(x[3], 0) - x[3], -settings.trust, -INFINITY * ca.DM.ones(2)]
        upper += [INFINITY, settings.trust, LEVER * (settings.heading - x[2]), LEVER * (settings.heading + x[2])]
    jacobian, to_bound = way.end
    rows.append(slope.rows(jacobian, len(settings.moves) - 1))
    lower.append(-INFINITY * ca.DM.ones(to_bound.shape[0]))
    upper.append(to_bound)
    low: list[Any] = [*way.low, ca.DM.zeros(len(settings.moves))]
    high: list[Any] = [*way.high, INFINITY * ca.DM.ones(len(settings.moves))]

    aim = way.aim if aimed else None
    h, g, cost = objective(settings, way, aimed)
    if aim is not None:
        for k, (x, by) in enumerate(zip(way.states, slopes, strict=True)):
            for i, weight, off in references(k, x, aim, way.weights):
                row = ca.horzcat(by[i, :], ca.SX(1, len(settings.moves)))
                h += 2 * weight * (row.T @ row)
                g += 2 * weight * off * row.T
                cost += weight * off**2
    a = ca.sparsify(ca.vertcat(*rows))
    out: list[Any] = [h, a, g, *(ca.vertcat(*v) for v in (low, high, lower, upper))]
    out += [way.trajectory, way.sides, way.violation, cost]
    function = ca.Function("program", way.arguments, [ca.densify(o) for o in out], _OPTIONS)
    rollout = ca.Function("rollout", way.arguments, [way.trajectory, way.violation, cost], _OPTIONS)
    return function, rollout, a.shape
