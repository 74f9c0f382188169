r"""The filter's quadratic program in sparse form, for OSQP, scaled, as one fused CasADi function without side effects.

The problem
-----------
Objective, stages, moves, sides and rows are those of `mpc.filter.program.condensed`, but uncondensed (multiple
shooting). The unknowns are the changes dz of the scaled inputs of each move about the guess, the deviations dx_k of the
states from the guess's rollout, and the slack of each move,

    min 1/2 x' P x + q' x   s.t.  l <= A x <= u,   x = (dz (2 moves), dx (4 N), slack (moves))

    rows: dx_k = Jx dx_{k-1} + Ju dz (4 N); bounds of dz and slack (3 moves); then those of the condensed program, in
    the same order.

Zero is the rollout of the guess. Elimination of dx gives the condensed program; `SparseProgram.judge` does so to
measure the quality of a solution.

Scaling
-------
In ADMM each row resists the motion of an unknown: row i by rho e_i^2, where e_i is the scale of the row (`_Scales`).
The resistance should be smaller for rows that a free plan moves further. So deviations of the states are propagated as
covariances under the curvature of the objective, and e_i falls with a power of them. Rows far from the guess resist
hardly at all, those of the dynamics a hundred times more. OSQP's own scaling would be repeated at each update, and is
not needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import casadi as ca
import numpy as np

from dynamics.state import FloatArray
from mpc.filter.problem import FilterProblem, FilterSettings
from mpc.filter.program.linearised import ENDS, INFINITY, LEVER, TANGENTS, Linearised, linearised
from mpc.filter.program.question import ProblemArrays, bind
from mpc.filter.program.road_step import StageModel
from mpc.filter.program.rows import SOFT, objective, references

__all__ = ["SparseProgram", "build_sparse"]


@dataclass(frozen=True, slots=True)
class _Scales:
    """Scales of the rows: factors, and powers of a free plan's deviation. They are tuned on recorded problems, where
    the result is flat around these values."""

    dynamics: float = 450.0
    acceleration: float = 8.5
    steering: float = 0.54
    slack: float = 300.0
    along: float = 6.3
    across: float = 2.9
    corridor: float = 1.0
    standing: float = 1.3
    trust: float = 0.48
    turned: float = 0.47
    stop: float = 9.4
    drift: float = 6.5
    tangent: float = 1.1
    far_along: float = 11.0
    far_across: float = 0.9
    inputs_power: float = -0.14
    along_power: float = 0.46
    across_power: float = 0.58
    speed_power: float = 0.22
    heading_power: float = 0.89


SCALES = _Scales()
_LEAST = 1e-4
"""Least scale of a row."""
_NONE = 1e-9
"""Magnitude below which a multiplier counts as zero."""
_SMALL = 1e-6
"""Added to variances, so that none is zero."""


class SparseProgram(ProblemArrays):
    """Compiled program of one size, in sparse form. The sparsity patterns never change.

    min 1/2 x' P x + q' x  s.t.  l <= A x <= u

    Attributes
    ----------
    P, A : entries of P's upper triangle and of A, column by column in `patterns`.
    q, l, u : the other arrays of the program.
    hold : scale of each row; a multiplier times this is the multiplier of the row in its own unit.
    patterns : (row indices, column pointers) of P and of A, and A's shape.
    answer, multipliers : x and its multipliers, inputs of `judge`.
    inputs_and_slack : (dz, slack) of the solution, in the order of the condensed program.
    primal, dual, first, gap : quality of the solution with eliminated states, (1,) each: greatest violation [m, or the
        row's unit], greatest entry of the gradient of the Lagrangian, that entry for the first input, and the sum of
        multiplier times room.
    miss : error of each row except the dynamics, in the row's unit: distance from its bound if it has a multiplier,
        else excess over its bounds.
    """

    def __init__(
        self, settings: FilterSettings, capacity: int, curved: bool, aimed: bool, model: StageModel | None = None
    ) -> None:
        function, rollout, judged = _compiled(settings, capacity, curved, aimed, model)
        p, a = function.sparsity_out(0), function.sparsity_out(1)
        rows, columns = a.shape
        moves = len(settings.moves)
        self.patterns = tuple((np.array(s.row()), np.array(s.colind()), s.shape) for s in (p, a))
        self.P, self.A = np.zeros(p.nnz()), np.zeros(a.nnz())
        self.q, self.l, self.u, self.hold = np.zeros(columns), np.zeros(rows), np.zeros(rows), np.zeros(rows)
        super().__init__(settings, capacity, function, rollout, (self.P, self.A, self.q, self.l, self.u, self.hold))
        self.answer, self.multipliers = np.zeros(columns), np.zeros(rows)
        self.inputs_and_slack = np.zeros(3 * moves)
        self.primal, self.dual, self.first, self.gap = (np.zeros(1) for _ in range(4))
        self.miss = np.zeros(rows - 4 * settings.stages)
        given = (self.P, self.A, self.q, self.l, self.u, self.hold, self.answer, self.multipliers)
        found = (self.inputs_and_slack, self.primal, self.dual, self.first, self.gap, self.miss)
        self._judge = bind(judged, given, found)

    def judge(self) -> None:
        """Measure the quality of `answer` and `multipliers`, and fill the attributes after them."""
        self._judge()


def build_sparse(
    problem: FilterProblem, inputs: FloatArray, settings: FilterSettings, model: StageModel | None = None
) -> SparseProgram:
    """The program of one problem, linearised about the rollout of `inputs` (N, 2), without a solver."""
    curved = problem.curvature is not None and bool(np.any(problem.curvature))
    capacity = max(int(problem.occupancy.shape[1]), 1)
    program = SparseProgram(settings, capacity, curved, problem.reference is not None, model)
    program.fill(problem, settings)
    program.inputs[:] = inputs
    program.linearise()
    return program


_OPTIONS = {"cse": True}


@lru_cache(maxsize=32)
def _compiled(
    settings: FilterSettings, m: int, curved: bool, aimed: bool, model: StageModel | None
) -> tuple[ca.Function, ca.Function, ca.Function]:
    way = linearised(settings, m, curved, model)
    aim = way.aim if aimed else None
    moves, n = len(settings.moves), settings.stages
    h, g, cost = objective(settings, way, aimed)
    by_state, at_state = ca.SX(4 * n, 4 * n), ca.SX(4 * n, 1)
    for k in range(n if aim is not None else 0):
        for i, weight, off in references(k, way.states[k], way.aim, way.weights):
            by_state[4 * k + i, 4 * k + i] = 2 * weight
            at_state[4 * k + i] = 2 * weight * off
            cost += weight * off**2
    split = 2 * moves
    p = ca.sparsify(ca.diagcat(h[:split, :split], by_state, h[split:, split:]))
    q = ca.densify(ca.vertcat(g[:split], at_state, g[split:]))
    rows, lower, upper, hold = _rows(settings, way, ca.densify(ca.diag(h)))
    a = ca.sparsify(ca.diag(hold) @ rows)
    bounds = [ca.if_else(ca.fabs(b) < INFINITY, b * hold, b) for b in (lower, upper)]
    out = [ca.triu(p), a, q, *bounds, hold, ca.densify(way.trajectory), way.sides, way.violation, cost]
    function = ca.Function("program", way.arguments, out, _OPTIONS)
    rollout = ca.Function("rollout", way.arguments, [ca.densify(way.trajectory), way.violation, cost], _OPTIONS)
    return function, rollout, _judged(settings, ca.triu(p).sparsity(), a.sparsity())


def _row(
    settings: FilterSettings, count: int, k: int | None, by_state: Any, move: int, by_input: Any, slack: float
) -> ca.SX:
    """`count` rows by the state of stage k, by the input of a move and by its slack."""
    n, moves = settings.stages, len(settings.moves)
    states = [ca.SX(count, 4) if i != k or by_state is None else by_state for i in range(n)]
    inputs = [ca.SX(count, 2) if j != move or by_input is None else by_input for j in range(moves)]
    slacks = [ca.SX(count, 1) if j != move or slack == 0 else slack * ca.SX.ones(count, 1) for j in range(moves)]
    return ca.horzcat(*inputs, *states, *slacks)


def _near(to_bound: ca.SX, far: float) -> ca.SX:
    """Factor on the scale of a row: 1 without room, a half with the room `far`, 0 far away."""
    return 1 / (1 + (ca.fmax(to_bound, 0) / far) ** 2)


def _rows(settings: FilterSettings, way: Linearised, curvature: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Rows in the order of the module's docstring, their bounds, and their scales.

    `curvature` is the diagonal of the objective's Hessian (3 moves, 1).
    """
    moves, n, c = len(settings.moves), settings.stages, SCALES
    of = [j for j, length in enumerate(settings.moves) for _ in range(length)]
    free = _deviations(settings, way, curvature)

    row = partial(_row, settings)
    rows: list[ca.SX] = []
    lower: list[Any] = []
    upper: list[Any] = []
    hold: list[Any] = []

    def add(block: ca.SX, low: Any, high: Any, scale: Any) -> None:
        rows.append(block)
        lower.append(low)
        upper.append(high)
        hold.append(scale)

    one, nothing = ca.DM.ones, ca.DM.zeros
    for k in range(n):
        jx, ju = way.slopes[k]
        before = row(4, k - 1, jx, of[k], ju, 0) if k > 0 else row(4, None, None, of[k], ju, 0)
        add(before - row(4, k, ca.SX.eye(4), 0, None, 0), nothing(4), nothing(4), c.dynamics * one(4))
    for j in range(moves):
        curved = ca.sparsify(curvature[2 * j : 2 * j + 2]) ** c.inputs_power
        scale = ca.vertcat(c.acceleration, c.steering) * curved
        add(row(2, None, None, j, ca.SX.eye(2), 0), way.low[j], way.high[j], scale)
    for j in range(moves):
        add(row(1, None, None, j, None, 1), nothing(1), INFINITY * one(1), c.slack * one(1))

    k = 0
    for j, length in enumerate(settings.moves):
        for _ in range(length):
            jacobian, to_bound = way.rows[k]
            along = c.along * free[k][0] ** -c.along_power * _near(to_bound[:2], c.far_along)
            across = free[k][1] ** -c.across_power * _near(to_bound[2:], c.far_across)
            across *= ca.vertcat(c.across * one(4), c.corridor * one(2))
            add(row(SOFT, k, jacobian, j, None, -1), -INFINITY * one(SOFT), to_bound, ca.vertcat(along, across))
            k += 1
        x, std = way.states[k - 1], free[k - 1]
        speed, heading = ca.SX(ca.DM([[0, 0, 0, 1]])), ca.SX(ca.DM([[0, 0, 1, 0]]))
        standing = c.standing * std[3] ** -c.speed_power
        turning = std[2] ** -c.heading_power
        add(row(1, k - 1, speed, j, None, 0), ca.fmin(x[3], 0) - x[3], INFINITY * one(1), standing)
        trust = settings.trust * one(1)
        add(row(1, k - 1, heading, j, None, 0), -trust, trust, c.trust * turning)
        turned = ca.vertcat(LEVER * heading, -LEVER * heading)
        most = ca.vertcat(LEVER * (settings.heading - x[2]), LEVER * (settings.heading + x[2]))
        add(row(2, k - 1, turned, j, None, -1), -INFINITY * one(2), most, c.turned * turning * one(2))
    jacobian, to_bound = way.end
    kept = ca.vertcat(c.stop, c.drift * one(4), c.tangent * one(len(TANGENTS)))
    distance = ca.vertcat(
        _near(to_bound[0], c.far_along), _near(to_bound[1:5], c.far_across), _near(to_bound[5:], c.far_along)
    )
    power = [free[-1][i] ** -p for i, p in ((0, c.along_power), (1, c.across_power))]
    moved = ca.vertcat(power[0], ca.repmat(power[1], 4, 1), ca.repmat(power[0], len(TANGENTS), 1))
    add(row(ENDS, n - 1, jacobian, moves - 1, None, -1), -INFINITY * one(ENDS), to_bound, kept * distance * moved)
    a, low, high, scales = (ca.vertcat(*v) for v in (rows, lower, upper, hold))
    return a, ca.densify(low), ca.densify(high), ca.densify(ca.fmax(scales, _LEAST))


def _deviations(settings: FilterSettings, way: Linearised, curvature: ca.SX) -> list[ca.SX]:
    """Standard deviations (4, 1) of the states at each stage, for inputs with variance 1 / curvature."""
    covariance, out, k = ca.SX(4, 4), [], 0
    for j, length in enumerate(settings.moves):
        for _ in range(length):
            jx, ju = way.slopes[k]
            variance = length / curvature[2 * j : 2 * j + 2]
            covariance = jx @ covariance @ jx.T + ju @ ca.diag(variance) @ ju.T
            out.append(ca.sqrt(ca.diag(covariance) + _SMALL))
            k += 1
    return out


def _judged(settings: FilterSettings, of_p: ca.Sparsity, of_a: ca.Sparsity) -> ca.Function:
    """Function from (P, A, q, l, u, hold, x, y) to ((dz, slack), primal, dual, first, gap, miss).

    A forward pass computes the states from the inputs, and a backward pass the gradient by the inputs.
    """
    moves, n = len(settings.moves), settings.stages
    inputs, states, dynamics = 2 * moves, 4 * n, 4 * n
    p, a = ca.SX.sym("p", of_p), ca.SX.sym("a", of_a)
    rows, columns = of_a.shape
    q, lower, upper, hold = (ca.SX.sym("v", size) for size in (columns, rows, rows, rows))
    x, y = ca.SX.sym("x", columns), ca.SX.sym("y", rows)
    z, slack = x[:inputs], x[inputs + states :]
    led: list[ca.SX] = []
    for k in range(n):
        here, own = slice(4 * k, 4 * k + 4), slice(inputs + 4 * k, inputs + 4 * k + 4)
        moved = a[here, :inputs] @ z
        if k > 0:
            moved += a[here, inputs + 4 * k - 4 : inputs + 4 * k] @ led[-1]
        led.append(-moved / ca.diag(a[here, own]))
    full = ca.vertcat(z, *led, slack)
    values = a[dynamics:, :] @ full
    low, high, multiplier = lower[dynamics:], upper[dynamics:], y[dynamics:]
    beyond = ca.fmax(low - values, values - high) / hold[dynamics:]
    to_bound = ca.if_else(multiplier > 0, high - values, values - low)
    # The multiplier of an absent bound is zero up to rounding.
    gap = ca.sum1(ca.if_else(ca.fabs(to_bound) < INFINITY / 2, ca.fabs(multiplier * to_bound), 0))
    symmetric = p + p.T - ca.diag(ca.diag(p))
    gradient = symmetric @ full + q + a[dynamics:, :].T @ multiplier
    by_input, after = gradient[:inputs], None
    for k in reversed(range(n)):
        here, own = slice(4 * k, 4 * k + 4), slice(inputs + 4 * k, inputs + 4 * k + 4)
        pull = gradient[own]
        if after is not None:
            pull += a[4 * k + 4 : 4 * k + 8, own].T @ after
        after = -pull / ca.diag(a[here, own])
        by_input += a[here, :inputs].T @ after
    dual = ca.mmax(ca.fabs(ca.vertcat(by_input, gradient[inputs + states :])))
    miss = ca.if_else(ca.fabs(multiplier) > _NONE, ca.fabs(to_bound) / hold[dynamics:], beyond)
    out = [ca.vertcat(z, slack), ca.fmax(ca.mmax(beyond), 0), dual, ca.mmax(ca.fabs(by_input[:2])), gap, miss]
    return ca.Function("judged", [p, a, q, lower, upper, hold, x, y], [ca.densify(o) for o in out], _OPTIONS)
