"""One problem about guessed inputs, stage by stage, as CasADi expressions for both forms of the program.

`mpc.filter.program.condensed` condenses them for DAQP. `mpc.filter.program.sparse` keeps the states for OSQP. So rows,
sides and violations are the same expressions in both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from mpc.filter.problem import FREE, FilterSettings
from mpc.filter.program.road_step import StageModel, stage_expression, without_reverse
from mpc.filter.program.rows import end_function, row_function
from mpc.filter.program.sides import SideChoice

__all__ = ["ENDS", "INFINITY", "LEVER", "MISC", "TANGENTS", "Linearised", "linearised"]

INFINITY = 1e30
"""Value for an absent bound in a program."""
MISC = 15
"""Number of entries of `ProblemArrays.misc`."""
LEVER = 5.0
"""Slack for a radian of heading beyond the limit [m]."""
TANGENTS = (6.0, 12.0, 18.0, 24.0, 30.0)
"""Additional speeds at which the stopping distance is linearised [m/s]."""
ENDS = 5 + len(TANGENTS)
"""Number of soft constraints at the end of the plan."""
_FAR = 1e3
"""Greatest distance of a soft bound from the guess [m]."""


@dataclass(frozen=True, slots=True)
class Linearised:
    """Expressions of one problem.

    Attributes
    ----------
    arguments : symbols, in the order of the arrays of `ProblemArrays`.
    inputs, curvature, aim, near, weights, speed, scale : symbols in the objective.
    states : state at the end of each stage, N of (4, 1).
    slopes : Jacobians of each stage by its state (4, 4) and by its *scaled* input (4, 2).
    rows : for each stage, constraints values <= limit: Jacobian by its state (n, 4) and remaining room (n, 1) [m].
    end : the same for the end of the plan.
    low, high : least and greatest change of the scaled inputs of each move, (2, 1).
    sides, violation : values of the guess, (m, N) and (1, 1).
    """

    arguments: list[ca.SX]
    inputs: ca.SX
    curvature: ca.SX
    aim: ca.SX
    near: ca.SX
    weights: ca.SX
    speed: ca.SX
    scale: ca.DM
    states: list[ca.SX]
    slopes: list[tuple[ca.SX, ca.SX]]
    rows: list[tuple[ca.SX, ca.SX]]
    end: tuple[ca.SX, ca.SX]
    low: list[ca.SX]
    high: list[ca.SX]
    sides: ca.SX
    violation: ca.SX

    @property
    def trajectory(self) -> ca.SX:
        """All states, (4, N)."""
        return ca.horzcat(*self.states)


def linearised(settings: FilterSettings, m: int, curved: bool, model: StageModel | None) -> Linearised:
    """Expressions for `m` obstacles, on a straight or a curved road."""
    n = settings.stages
    x0, u = ca.SX.sym("x0", 4), ca.SX.sym("u", 2, n)
    occupied = ca.SX.sym("occupied", 4, m * n)
    rest, edges, corridor = ca.SX.sym("rest", m), ca.SX.sym("edges", 2, n), ca.SX.sym("corridor", 2, n)
    curvature, aim, misc = ca.SX.sym("curvature", n), ca.SX.sym("aim", 2, n), ca.SX.sym("misc", MISC)
    lon, lat, stop, near, limits, weights = misc[0], misc[1], misc[2], misc[3:5], misc[5:9], misc[9:15]
    given = ca.SX.sym("given", m, n)
    scale = ca.DM([0.5 * (settings.acceleration[1] - settings.acceleration[0]), settings.steering])
    stages = {frames: _stage_function(settings, frames, curved, model) for frames in set(settings.frames)}
    row, ends = row_function(), settings.ends
    choice = SideChoice(m, lon, lat, given)

    x, states, slopes, violations, rows = x0, [], [], [], []
    low: list[Any] = []
    high: list[Any] = []
    choice.start(x0, occupied[:, :m], settings.dt * ends[0])
    k = 0
    for length in settings.moves:
        below, above = ca.SX(-FREE * ca.DM.ones(2)), ca.SX(FREE * ca.DM.ones(2))
        for _ in range(length):
            below = ca.fmax(below, (limits[0::2] - u[:, k]) / scale)
            above = ca.fmin(above, (limits[1::2] - u[:, k]) / scale)
            x, jx, ju = stages[settings.frames[k]](x, u[:, k], curvature[k])
            slopes.append((jx, ju @ ca.diag(scale)))
            states.append(x)
            bounds, clear = choice.step(k, x, occupied[:, k * m : (k + 1) * m], settings.dt * ends[k])
            s_high, s_low, r_high, r_low = bounds
            r_high, r_low = ca.fmin(r_high, edges[1, k]), ca.fmax(r_low, edges[0, k])
            values, jacobian = row(x, lon, lat)
            to_bound = (
                ca.vertcat(s_high, -s_low, r_high, r_high, -r_low, -r_low, corridor[1, k], -corridor[0, k]) - values
            )
            outside = ca.vertcat(edges[1, k] - values[2:4], -edges[0, k] - values[4:6], to_bound[6:8])
            violations.append(ca.fmax(-ca.mmin(outside), -clear))
            rows.append((jacobian, ca.fmin(to_bound, _FAR)))
            k += 1
        low.append(below)
        high.append(above)
    values, jacobian = end_function(settings.braking)(x, lon, lat)
    limit = ca.fmin(choice.rest(rest), stop)
    to_bound = ca.vertcat(limit, ca.repmat(edges[1, n - 1], 2, 1), ca.repmat(-edges[0, n - 1], 2, 1)) - values
    violations.append(-ca.mmin(to_bound))
    # The stopping distance is convex in the speed. Tangents at other speeds than the guess's are valid rows too.
    others = ca.DM(TANGENTS)
    gain = (others - x[3]) ** 2 / (2 * settings.braking)
    bent = ca.repmat(jacobian[0, :], others.numel(), 1)
    bent[:, 3] = others / settings.braking
    end = ca.vertcat(jacobian, bent), ca.fmin(ca.vertcat(to_bound, to_bound[0] + gain), _FAR)
    violation = ca.fmax(0, ca.mmax(ca.vertcat(*violations)))
    arguments = [x0, u, occupied, rest, edges, corridor, curvature, aim, misc, given]
    question = (u, curvature, aim, near, weights, x0[3], scale)
    return Linearised(arguments, *question, states, slopes, rows, end, low, high, choice.table(), violation)


def _stage_function(settings: FilterSettings, frames: int, curved: bool, model: StageModel | None) -> ca.Function:
    """One stage of `frames` frames, with its Jacobians."""
    x, u, k = ca.SX.sym("x", 4), ca.SX.sym("u", 2), ca.SX.sym("k")
    repeated = without_reverse(u, x[3], settings.dt * frames)
    after = stage_expression(x, repeated, k if curved else None, settings.dt, frames, model)
    return ca.Function("stage", [x, u, k], [after, ca.jacobian(after, x), ca.jacobian(after, u)])
