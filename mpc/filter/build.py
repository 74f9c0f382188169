r"""The filter's quadratic program as one fused CasADi function. Pure: arrays in, arrays out, no solver.

The problem
-----------
With z = u / (half the range of the input), proposal z_p, road states x_k at the end of stage k:

    min  w |z_0 - z_p|^2 + smoothing sum |z_k - z_{k-1}|^2 + magnitude sum |z_k - z_ff|^2
         + reference terms in r_k, psi_k, v_k + penalty sum sigma
    s.t. x_{k+1} = F(x_k, u_k) (Euler frames, exactly; or a model)        u in its box, v_k >= 0
         s_k + h_s(psi_k) <= s_min of those that are passed behind        s_k - h_s >= s_max of those passed ahead
         r_k + lat cos psi_k +- lon sin psi_k <= r_min, upper edge        the same at the lower side
         corridor_low <= r_k <= corridor_high
         s_N + h_s + v_N^2 / (2 b) <= where those behind which it ends come to rest, and `stop`
         r_N + v_N^2 / (2 b) sin psi_N, with the footprint, between the edges

where every constraint after the box is relaxed by the slack sigma >= 0 [m] that the stages of a move share. All
obstacles that are passed on the same side share a row: only the tightest bound counts, so that the size of the
program does not depend on their number.

It is linearised about the rollout of guessed inputs and condensed: the unknowns are the changes of the inputs about
the guess, one for each *move* (several stages that change alike; the guess itself may differ from stage to stage, so
that moving a plan on loses nothing), and the slack of each move. Zero is always a feasible point up to slack. The
heading's change is limited to the trust region.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from dynamics.state import FloatArray
from mpc.filter.problem import FREE, FilterProblem, FilterSettings, Occupied
from mpc.filter.road_step import StageModel, stage_expression
from mpc.filter.rows import SOFT, Sensitivity, end_function, objective, row_function
from mpc.filter.sides import SideChoice

__all__ = ["INFINITY", "Program", "Weights", "bind", "build"]

INFINITY = 1e30
"""Stands for no bound in a program."""
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
    """One compiled problem size: fill the inputs, `linearise`, read the outputs. Owns every array, sizes never change.

    min 1/2 w' H w + g' w  s.t.  low <= w <= high,  lower <= A w <= upper

    Attributes
    ----------
    state (4,), inputs (N, 2), occupancy (N, m, 4), rest (m,), edges (N, 2), corridor (N, 2), curvature (N,),
    aim (N, 2), misc (15,), given (N, m) : what to fill in. misc is lon, lat, stop, proposal (2), limits (4),
        weights (6); given is a side, or -1 where it is to be chosen.
    H, A : dense, column-major.
    g, low, high, lower, upper : the rest of the program.
    states (N, 4), sides (N, m), violation (1,), cost (1,) : of the guess, by the exact rollout.
    """

    def __init__(
        self, settings: FilterSettings, capacity: int, curved: bool, aimed: bool, model: StageModel | None = None
    ) -> None:
        n, m = settings.stages, capacity
        function, rollout, shape = _compiled(settings, capacity, curved, aimed, model)
        self.settings = settings
        self.state, self.inputs = np.zeros(4), np.zeros((n, 2))
        self.occupancy, self.rest = np.full((n, m, 4), FREE), np.full(m, FREE)
        self.edges, self.corridor = np.tile([-FREE, FREE], (n, 1)), np.tile([-FREE, FREE], (n, 1))
        self.curvature, self.aim, self.misc = np.zeros(n), np.zeros((n, 2)), np.zeros(_MISC)
        rows, columns = shape
        self.H, self.A = np.zeros((columns, columns), order="F"), np.zeros((rows, columns), order="F")
        self.g, self.low, self.high = np.zeros(columns), np.zeros(columns), np.zeros(columns)
        self.lower, self.upper = np.zeros(rows), np.zeros(rows)
        self.states, self.sides, self.given = np.zeros((n, 4)), np.zeros((n, m)), np.full((n, m), -1.0)
        self.violation, self.cost = np.zeros(1), np.zeros(1)
        self.scale = np.array([0.5 * (settings.acceleration[1] - settings.acceleration[0]), settings.steering])
        arguments = (self.state, self.inputs, self.occupancy, self.rest, self.edges, self.corridor, self.curvature)
        program = (self.H, self.A, self.g, self.low, self.high, self.lower, self.upper)
        rest = (self.states, self.sides, self.violation, self.cost)
        given = (*arguments, self.aim, self.misc, self.given)
        self._linearise = bind(function, given, (*program, *rest))
        self._roll_out = bind(rollout, given, (self.states, self.violation, self.cost))

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

    @property
    def wanted(self) -> FloatArray | None:
        """The nearest allowed input to the proposal, (2,); None where a reference is aimed at as well."""
        if self.misc[9] == 0 or self.misc[12:15].any():
            return None
        return np.clip(self.misc[3:5], *self.limits)

    @property
    def merit(self) -> float:
        """Cost of `inputs` with what they violate beyond the tolerance: what a step has to lower."""
        return float(self.cost[0] + self.settings.penalty * max(self.violation[0] - self.settings.tolerance, 0.0))

    def free_sides(self) -> None:
        """Choose the sides anew with each guess."""
        self.given[:] = -1.0

    def keep_sides(self) -> None:
        """Stay with the sides chosen by the last call."""
        self.given[:] = self.sides

    def linearise(self) -> None:
        """About the rollout of `inputs`: fills every output."""
        self._linearise()

    def roll_out(self) -> None:
        """`inputs` again, for `states`, `violation` and `cost` alone."""
        self._roll_out()


def build(
    problem: FilterProblem, inputs: FloatArray, settings: FilterSettings, model: StageModel | None = None
) -> Program:
    """The program for one problem, linearised about the rollout of `inputs` (N, 2); pure, without a solver."""
    curved = problem.curvature is not None and bool(np.any(problem.curvature))
    program = Program(settings, max(int(problem.occupancy.shape[1]), 1), curved, problem.reference is not None, model)
    program.fill(problem, settings)
    program.inputs[:] = inputs
    program.linearise()
    return program


_MISC = 15
_OPTIONS = {"cse": True}
_HEADING = ca.SX(ca.DM([[0, 0, 1, 0]]))
_SPEED = ca.SX(ca.DM([[0, 0, 0, 1]]))
_LEVER = 5.0
"""What a radian of heading beyond the limit counts for in slack [m]."""
TANGENTS = (6.0, 12.0, 18.0, 24.0, 30.0)
"""Further speeds at which the way to a stop is linearised [m/s]."""
_TURNED = ca.SX(ca.DM([[0, 0, _LEVER, 0], [0, 0, -_LEVER, 0]]))


def bind(
    function: ca.Function, arguments: tuple[FloatArray, ...], results: tuple[FloatArray, ...]
) -> Callable[[], None]:
    """A call of the function that reads and writes these arrays in place, without copies or conversions."""
    buffer, call = function.buffer()
    for i, array in enumerate(arguments):
        buffer.set_arg(i, memoryview(array.reshape(-1, order="A")))  # type: ignore[call-arg, arg-type]
    for i, array in enumerate(results):
        buffer.set_res(i, memoryview(array.reshape(-1, order="A")))  # type: ignore[call-arg, arg-type]

    def run(keep: tuple[Any, ...] = (buffer, arguments, results)) -> None:
        call()

    return run


@lru_cache(maxsize=32)
def _compiled(
    settings: FilterSettings, m: int, curved: bool, aimed: bool, model: StageModel | None
) -> tuple[ca.Function, ca.Function, tuple[int, int]]:
    n = settings.stages
    x0, u = ca.SX.sym("x0", 4), ca.SX.sym("u", 2, n)
    occupied = ca.SX.sym("occupied", 4, m * n)
    rest, edges, corridor = ca.SX.sym("rest", m), ca.SX.sym("edges", 2, n), ca.SX.sym("corridor", 2, n)
    curvature, aim, misc = ca.SX.sym("curvature", n), ca.SX.sym("aim", 2, n), ca.SX.sym("misc", _MISC)
    lon, lat, stop, near, limits, weights = misc[0], misc[1], misc[2], misc[3:5], misc[5:9], misc[9:15]
    given = ca.SX.sym("given", m, n)
    scale = ca.DM([0.5 * (settings.acceleration[1] - settings.acceleration[0]), settings.steering])
    stages = {frames: _stage_function(settings, frames, curved, model) for frames in set(settings.frames)}
    row, ends = row_function(), settings.ends
    choice, slope = SideChoice(m, lon, lat, given), Sensitivity(settings, scale)

    x, states, slopes, violations, rows = x0, [], [], [], []
    lower: list[Any] = []
    upper: list[Any] = []
    low: list[Any] = []
    high: list[Any] = []
    choice.start(x0, occupied[:, :m], settings.dt * ends[0])
    k = 0
    for j, length in enumerate(settings.moves):
        below, above = ca.SX(-FREE * ca.DM.ones(2)), ca.SX(FREE * ca.DM.ones(2))
        for _ in range(length):
            below = ca.fmax(below, (limits[0::2] - u[:, k]) / scale)
            above = ca.fmin(above, (limits[1::2] - u[:, k]) / scale)
            x, jx, ju = stages[settings.frames[k]](x, u[:, k], curvature[k])
            slopes.append(slope.step(j, jx, ju))
            states.append(x)
            bounds, clear = choice.step(k, x, occupied[:, k * m : (k + 1) * m], settings.dt * ends[k])
            s_high, s_low, r_high, r_low = bounds
            r_high, r_low = ca.fmin(r_high, edges[1, k]), ca.fmax(r_low, edges[0, k])
            values, jacobian = row(x, lon, lat)
            room = ca.vertcat(s_high, -s_low, r_high, r_high, -r_low, -r_low, corridor[1, k], -corridor[0, k]) - values
            outside = ca.vertcat(edges[1, k] - values[2:4], -edges[0, k] - values[4:6], room[6:8])
            violations.append(ca.fmax(-ca.mmin(outside), -clear))
            rows.append(slope.rows(jacobian, j))
            lower.append(-INFINITY * ca.DM.ones(SOFT))
            upper.append(ca.fmin(room, _FAR))
            k += 1
        # Speed is linear within a move: not negative at its end is not negative within.
        rows += [slope.hard(_SPEED), slope.hard(_HEADING), slope.rows(_TURNED, j)]
        lower += [ca.fmin(x[3], 0) - x[3], -settings.trust, -INFINITY * ca.DM.ones(2)]
        upper += [INFINITY, settings.trust, _LEVER * (settings.heading - x[2]), _LEVER * (settings.heading + x[2])]
        low.append(below)
        high.append(above)
    values, jacobian = end_function(settings.braking)(x, lon, lat)
    limit = ca.fmin(choice.rest(rest), stop)
    room = ca.vertcat(limit, ca.repmat(edges[1, n - 1], 2, 1), ca.repmat(-edges[0, n - 1], 2, 1)) - values
    violations.append(-ca.mmin(room))
    # The stop is convex in the speed: tangents at other speeds than the guess's are valid rows as well, and tighten it.
    others = ca.DM(TANGENTS)
    gain = (others - x[3]) ** 2 / (2 * settings.braking)
    bent = ca.repmat(jacobian[0, :], others.numel(), 1)
    bent[:, 3] = others / settings.braking
    rows.append(slope.rows(ca.vertcat(jacobian, bent), len(settings.moves) - 1))
    lower.append(-INFINITY * ca.DM.ones(5 + others.numel()))
    upper.append(ca.fmin(ca.vertcat(room, room[0] + gain), _FAR))
    low.append(ca.DM.zeros(len(settings.moves)))
    high.append(INFINITY * ca.DM.ones(len(settings.moves)))

    a = ca.sparsify(ca.vertcat(*rows))
    h, g, cost = objective(settings, states, slopes, u, curvature, aim if aimed else None, near, weights, scale, x0[3])
    violation = ca.fmax(0, ca.mmax(ca.vertcat(*violations)))
    out = [h, a, g, ca.vertcat(*low), ca.vertcat(*high), ca.vertcat(*lower), ca.vertcat(*upper)]
    out += [ca.horzcat(*states), choice.table(), violation, cost]
    arguments = [x0, u, occupied, rest, edges, corridor, curvature, aim, misc, given]
    function = ca.Function("program", arguments, [ca.densify(o) for o in out], _OPTIONS)
    rollout = ca.Function("rollout", arguments, [ca.horzcat(*states), violation, cost], _OPTIONS)
    return function, rollout, a.shape


def _stage_function(settings: FilterSettings, frames: int, curved: bool, model: StageModel | None) -> ca.Function:
    """One stage of so many frames and its Jacobians."""
    x, u, k = ca.SX.sym("x", 4), ca.SX.sym("u", 2), ca.SX.sym("k")
    after = stage_expression(x, u, k if curved else None, settings.dt, frames, model)
    return ca.Function("stage", [x, u, k], [after, ca.jacobian(after, x), ca.jacobian(after, u)])
