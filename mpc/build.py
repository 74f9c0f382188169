r"""The filter's quadratic program as one fused CasADi function. Pure: arrays in, arrays out, no solver.

The problem
-----------
With z = u / (half the range of the input), proposal z_p, road states x_k at the end of stage k:

    min  w |z_0 - z_p|^2 + smoothing sum |z_k - z_{k-1}|^2 + magnitude sum |z_k - z_ff|^2
         + reference terms in r_k, psi_k, v_k + penalty sum sigma_k
    s.t. x_{k+1} = F(x_k, u_k) (Euler frames, exactly)                    u in its box, v_k >= 0
         s_k + h_s(psi_k) <= s_min of those that are passed behind        s_k - h_s >= s_max of those passed ahead
         r_k + lat cos psi_k +- lon sin psi_k <= r_min, upper edge        the same at the lower side
         corridor_low <= r_k <= corridor_high
         s_N + h_s + v_N^2 / (2 b) <= where those behind which it ends come to rest, and `stop`
         r_N + v_N^2 / (2 b) sin psi_N, with the footprint, between the edges

where every constraint after the box is relaxed by the slack sigma_k >= 0 [m] of its stage. All obstacles that are
passed on the same side share a row: only the tightest bound counts, so that the size of the program does not
depend on their number.

It is linearised about the rollout of guessed inputs; the program's unknowns are the deviations from it, per stage
(dz (2), dx_{k+1} (4) / `STATE_SCALE`, sigma), so that zero is a feasible point up to slack. The heading's
deviation is limited to the trust region.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from scipy import sparse

from dynamics.state import FloatArray
from mpc.problem import FREE, FilterProblem, FilterSettings, Occupied
from mpc.road_step import stage_expression
from mpc.rows import COLUMNS, INFINITY, ROWS, STATE_SCALE, assemble, end_function, objective, row_function
from mpc.sides import SideChoice

__all__ = ["COLUMNS", "INFINITY", "ROWS", "STATE_SCALE", "Program", "Weights", "build"]

_FAR = 1e3
"""No soft bound is further away from the guess than this [m]."""


@dataclass(frozen=True, slots=True)
class Weights:
    """Weights of one problem, as the function takes them."""

    acceleration: float
    steering: float
    first: float
    lateral: float
    heading: float
    speed: float

    @classmethod
    def of(cls, problem: FilterProblem, settings: FilterSettings) -> Weights:
        """From the problem: the first input is free of smoothing where there is a proposal to stay near to."""
        near = problem.proposal is not None
        aim = problem.reference
        lateral, heading, speed = (aim.lateral, aim.heading, aim.speed) if aim is not None else (0.0, 0.0, 0.0)
        return cls(float(near), float(near), 0.0 if near else settings.smoothing, lateral, heading, speed)


class Program:
    """One compiled problem size: fill the inputs, `call`, read the outputs. Owns every array, sizes never change.

    Attributes
    ----------
    state (4,), inputs (N, 2), occupancy (N, m, 4), rest (m,), edges (N, 2), corridor (N, 2), curvature (N,),
    aim (N, 2), misc (15,) : what to fill in; misc is lon, lat, stop, proposal (2), limits (4), weights (6).
    P, A : csc matrices whose `data` the call writes; P holds the upper triangle.
    q, lower, upper : the rest of the program.
    states (N, 4), sides (N, m), violation (1,) : of the guess.
    """

    def __init__(self, settings: FilterSettings, capacity: int, curved: bool) -> None:
        n, m = settings.stages, capacity
        function, p_pattern, a_pattern = _compiled(settings, capacity, curved)
        self.capacity, self.curved = capacity, curved
        self.state, self.inputs = np.zeros(4), np.zeros((n, 2))
        self.occupancy, self.rest = np.full((n, m, 4), FREE), np.full(m, FREE)
        self.edges, self.corridor = np.tile([-FREE, FREE], (n, 1)), np.tile([-FREE, FREE], (n, 1))
        self.curvature, self.aim, self.misc = np.zeros(n), np.zeros((n, 2)), np.zeros(_MISC)
        self.P, self.A = _csc(p_pattern), _csc(a_pattern)
        rows, columns = self.A.shape
        self.q, self.lower, self.upper = np.zeros(columns), np.zeros(rows), np.zeros(rows)
        self.states, self.sides, self.violation = np.zeros((n, 4)), np.zeros((n, m)), np.zeros(1)
        self._buffer, self._call = function.buffer()
        arguments = (self.state, self.inputs, self.occupancy, self.rest, self.edges, self.corridor, self.curvature)
        for i, array in enumerate((*arguments, self.aim, self.misc)):
            self._buffer.set_arg(i, memoryview(array.reshape(-1)))  # type: ignore[call-arg, arg-type]
        results = (self.P.data, self.A.data, self.q, self.lower, self.upper, self.states, self.sides, self.violation)
        for i, array in enumerate(results):
            self._buffer.set_res(i, memoryview(array.reshape(-1)))  # type: ignore[call-arg, arg-type]

    def fill(self, problem: FilterProblem, settings: FilterSettings) -> None:
        """Everything but the guess, which is `inputs`."""
        m = int(problem.occupancy.shape[1])
        self.state[:] = problem.state
        np.clip(problem.occupancy, -FREE, FREE, out=self.occupancy[:, :m])
        self.occupancy[:, m:] = FREE
        ends = problem.occupancy[-1, :, Occupied.S_MIN] if problem.rest is None else problem.rest
        np.clip(ends, -FREE, FREE, out=self.rest[:m])
        self.rest[m:] = FREE
        for target, pair in ((self.edges, problem.edges), (self.corridor, problem.corridor)):
            target[:, 0], target[:, 1] = pair
        np.clip(self.edges, -FREE, FREE, out=self.edges)
        np.clip(self.corridor, -FREE, FREE, out=self.corridor)
        if problem.curvature is not None:
            self.curvature[:] = problem.curvature
        aim = problem.reference
        self.aim[:, 0], self.aim[:, 1] = (aim.r, aim.v) if aim is not None else (0.0, 0.0)
        weights = Weights.of(problem, settings)
        near = problem.proposal if problem.proposal is not None else (0.0, 0.0)
        limits = np.array([settings.acceleration, (-settings.steering, settings.steering)])
        if problem.limits is not None:
            limits = np.asarray(problem.limits, dtype=float)
        self.misc[:] = (
            *problem.half,
            min(problem.stop, FREE),
            *near,
            *limits.ravel(),
            weights.acceleration,
            weights.steering,
            weights.first,
            weights.lateral,
            weights.heading,
            weights.speed,
        )

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """Least and greatest input, (2,) each."""
        return self.misc[5:9:2], self.misc[6:9:2]

    def call(self) -> None:
        """Linearise about the rollout of `inputs`."""
        self._call()


def build(problem: FilterProblem, inputs: FloatArray, settings: FilterSettings) -> Program:
    """The program for one problem, linearised about the rollout of `inputs` (N, 2); pure, without a solver."""
    curved = problem.curvature is not None and bool(np.any(problem.curvature))
    program = Program(settings, max(int(problem.occupancy.shape[1]), 1), curved)
    program.fill(problem, settings)
    program.inputs[:] = inputs
    program.call()
    return program


_MISC = 15


def _csc(pattern: ca.Sparsity) -> Any:
    rows, columns = pattern.shape
    data = np.zeros(pattern.nnz())
    return sparse.csc_matrix((data, np.array(pattern.row()), np.array(pattern.colind())), shape=(rows, columns))


@lru_cache(maxsize=16)
def _compiled(settings: FilterSettings, m: int, curved: bool) -> tuple[ca.Function, ca.Sparsity, ca.Sparsity]:
    n = settings.stages
    x0, u = ca.SX.sym("x0", 4), ca.SX.sym("u", 2, n)
    occupied = ca.SX.sym("occupied", 4, m * n)
    rest, edges, corridor = ca.SX.sym("rest", m), ca.SX.sym("edges", 2, n), ca.SX.sym("corridor", 2, n)
    curvature, aim, misc = ca.SX.sym("curvature", n), ca.SX.sym("aim", 2, n), ca.SX.sym("misc", _MISC)
    lon, lat, stop, near, limits, weights = misc[0], misc[1], misc[2], misc[3:5], misc[5:9], misc[9:15]
    scale = ca.DM([0.5 * (settings.acceleration[1] - settings.acceleration[0]), settings.steering])
    stage = _stage_function(settings, curved)
    row = row_function()
    bounds = SideChoice(m, lon, lat, settings.stage)

    x, states, blocks, violations = x0, [], [], []
    lower: list[Any] = []
    upper: list[Any] = []
    bounds.start(x0, occupied[:, :m])
    for k in range(n):
        x, jx, ju = stage(x, u[:, k], curvature[k])
        states.append(x)
        tight, clear = bounds.step(k, x, occupied[:, k * m : (k + 1) * m])
        s_high, s_low, r_high, r_low = tight
        r_high, r_low = ca.fmin(r_high, edges[1, k]), ca.fmax(r_low, edges[0, k])
        values, jacobian = row(x, lon, lat)
        limit = ca.vertcat(s_high, -s_low, r_high, r_high, -r_low, -r_low, corridor[1, k], -corridor[0, k])
        room = limit - values
        outside = ca.vertcat(edges[1, k] - values[2:4], -edges[0, k] - values[4:6], room[6:8])
        violations.append(ca.fmax(-ca.mmin(outside), -clear))
        blocks.append((jx, ju, jacobian))
        dz = ca.vertcat(limits[0], limits[2], limits[1], limits[3]) - ca.vertcat(u[:, k], u[:, k])
        lower += [ca.DM.zeros(4), dz[:2] / scale, (ca.fmin(x[3], 0) - x[3]) / STATE_SCALE[3]]
        lower += [-settings.trust / STATE_SCALE[2], 0, -INFINITY * ca.DM.ones(8)]
        upper += [ca.DM.zeros(4), dz[2:] / scale, INFINITY, settings.trust / STATE_SCALE[2], INFINITY]
        upper += [ca.fmin(room, _FAR)]
    values, jacobian = end_function(settings.braking)(x, lon, lat)
    ends = ca.fmin(bounds.rest(rest), stop)
    room = ca.vertcat(ends, ca.repmat(edges[1, n - 1], 2, 1), ca.repmat(-edges[0, n - 1], 2, 1)) - values
    violations.append(-ca.mmin(room))
    lower.append(-INFINITY * ca.DM.ones(5))
    upper.append(ca.fmin(room, _FAR))

    a = assemble(blocks, jacobian, scale)
    p, q = objective(settings, states, u, curvature, aim, near, weights, scale)
    violation = ca.fmax(0, ca.mmax(ca.vertcat(*violations)))
    out = [p, a, q, ca.vertcat(*lower), ca.vertcat(*upper), ca.horzcat(*states), bounds.table(), violation]
    arguments = [x0, u, occupied, rest, edges, corridor, curvature, aim, misc]
    function = ca.Function("program", arguments, out, {"cse": True})
    return function, p.sparsity(), a.sparsity()


def _stage_function(settings: FilterSettings, curved: bool) -> ca.Function:
    """One stage and its Jacobians."""
    x, u, k = ca.SX.sym("x", 4), ca.SX.sym("u", 2), ca.SX.sym("k")
    after = stage_expression(x, u, k if curved else None, settings.dt, settings.substeps)
    return ca.Function("stage", [x, u, k], [after, ca.jacobian(after, x), ca.jacobian(after, u)])
