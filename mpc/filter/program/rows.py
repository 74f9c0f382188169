"""Sensitivities, rows and objective of the filter's program, as CasADi expressions.

`mpc.filter.program.linearised` and `mpc.filter.program.condensed` combine them.

Notation
--------
w = (dz of each move (2 each), slack of each move): the unknowns. dz is the change of the scaled inputs of all stages of
a move about the guess. S_k = d x_k / d w for the inputs' columns, (4, 2 moves), by the chain rule over the stages.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi as ca

from mpc.filter.problem import FilterSettings
from mpc.filter.program.road_step import feed_forward
from mpc.filter.program.sides import along

if TYPE_CHECKING:
    from mpc.filter.program.linearised import Linearised

__all__ = ["SOFT", "TURNS", "Sensitivity", "end_function", "objective", "references", "row_function"]

SOFT = 8
"""Number of soft constraints of a stage."""
TURNS = 4
"""Number of rows at the end of a move: speed, trust region, heading to either side."""
_STEERING_SPEED = 5.0
"""Speed in the weight of later steering, which grows with the square of v over this speed [m/s]."""


class Sensitivity:
    """Propagates d x_k / d w from stage to stage (at build time)."""

    def __init__(self, settings: FilterSettings) -> None:
        self._moves = len(settings.moves)
        self.now = ca.SX(4, 2 * self._moves)

    def step(self, move: int, jx: ca.SX, ju: ca.SX) -> ca.SX:
        """Propagate over one stage of a move, with Jacobians jx (4, 4) and ju (4, 2) by the scaled input."""
        own = ca.horzcat(ca.SX(4, 2 * move), ju, ca.SX(4, 2 * (self._moves - move - 1)))
        self.now = ca.sparsify(jx @ self.now + own)
        return self.now

    def rows(self, jacobian: ca.SX, move: int) -> ca.SX:
        """Soft rows (n, unknowns) of a stage of that move, from their Jacobian by its state (n, 4)."""
        count = jacobian.shape[0]
        slack = ca.horzcat(ca.SX(count, move), -ca.SX.ones(count, 1), ca.SX(count, self._moves - move - 1))
        return ca.horzcat(ca.sparsify(jacobian @ self.now), slack)

    def hard(self, row: ca.SX) -> ca.SX:
        """A row (1, 4) by the state, without slack."""
        return ca.horzcat(ca.sparsify(row @ self.now), ca.SX(1, self._moves))


def row_function() -> ca.Function:
    """The eight soft constraints of a stage, each as value <= limit, and their Jacobian."""
    x, lon, lat = ca.SX.sym("x", 4), ca.SX.sym("lon"), ca.SX.sym("lat")
    s, r, psi = x[0], x[1], x[2]
    h, across, corner = along(psi, lon, lat), lat * ca.fabs(ca.cos(psi)), lon * ca.sin(psi)
    values = ca.vertcat(
        s + h, -s + h, r + across + corner, r + across - corner, -r + across + corner, -r + across - corner, r, -r
    )
    return ca.Function("rows", [x, lon, lat], [values, ca.jacobian(values, x)])


def end_function(braking: float) -> ca.Function:
    """Stopping position after the horizon, straight ahead, with its Jacobian: along (1), across (4)."""
    x, lon, lat = ca.SX.sym("x", 4), ca.SX.sym("lon"), ca.SX.sym("lat")
    distance = x[3] * ca.fabs(x[3]) / (2 * braking)
    drift = x[1] + distance * ca.sin(x[2])
    across, corner = lat * ca.fabs(ca.cos(x[2])), lon * ca.sin(x[2])
    front = x[0] + along(x[2], lon, lat) + distance
    sides = [drift + across + corner, drift + across - corner, -drift + across + corner, -drift + across - corner]
    values = ca.vertcat(front, *sides)
    return ca.Function("ends", [x, lon, lat], [values, ca.jacobian(values, x)])


def objective(settings: FilterSettings, way: Linearised, aimed: bool) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Hessian, gradient at the guess, and cost of the guess, without the terms of `references`; `aimed` is whether
    there is a reference."""
    weights, scale = way.weights, way.scale
    moves = len(settings.moves)
    w = ca.SX.sym("w", 3 * moves)
    of = [j for j, length in enumerate(settings.moves) for _ in range(length)]
    z = way.inputs / ca.repmat(scale, 1, settings.stages)
    moved = [z[:, k] + w[2 * j : 2 * j + 2] for k, j in enumerate(of)]
    cost = ca.dot(weights[:2], (moved[0] - way.near / scale) ** 2)
    for k in range(1, settings.stages):
        weight = weights[2] if k == 1 else settings.smoothing
        center = way.aim[0, k] if aimed else ca.SX(0)
        off = moved[k] - ca.vertcat(0, feed_forward(way.curvature[k], center) / scale[1])
        cost += weight * ca.sumsqr(moved[k] - moved[k - 1])
        lively = 1 + (way.speed / _STEERING_SPEED) ** 2
        cost += settings.magnitude * off[0] ** 2 + settings.steadiness * lively * off[1] ** 2
        cost += settings.damping * lively * w[2 * of[k] + 1] ** 2
    slack = w[2 * moves :]
    cost += settings.penalty * ca.sum1(slack) + 0.5 * settings.curving * ca.sumsqr(slack)
    hessian, gradient = ca.hessian(cost, w)
    here = ca.substitute(cost, w, ca.DM.zeros(3 * moves))
    gradient = ca.substitute(gradient, w, ca.DM.zeros(3 * moves))
    return hessian, gradient, here


def references(k: int, x: ca.SX, aim: ca.SX, weights: ca.SX) -> list[tuple[int, ca.SX, ca.SX]]:
    """Terms weight * off^2 of the objective at the end of stage k: index of the state, weight, off."""
    return [(1, weights[3], x[1] - aim[0, k]), (2, weights[4], x[2]), (3, weights[5], x[3] - aim[1, k])]
