"""The rows and the objective of the filter's program, as CasADi expressions; `mpc.build` puts them together."""

from __future__ import annotations

import casadi as ca

from mpc.problem import FilterSettings
from mpc.road_step import feed_forward
from mpc.sides import along

__all__ = ["COLUMNS", "INFINITY", "ROWS", "STATE_SCALE", "assemble", "end_function", "objective", "row_function"]

STATE_SCALE = (20.0, 2.0, 0.2, 5.0)
"""What a state's deviation is measured in: s, r, psi, v [m, m, rad, m/s]."""
INFINITY = 1e30
"""OSQP's infinity."""
COLUMNS = 7
"""Unknowns of a stage: two inputs, four states, the slack."""
ROWS = 17
"""Constraints of a stage: four of the dynamics, two inputs, speed, heading, slack, eight soft ones."""


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
    """Where the plan would stop after the horizon, straight ahead along the road: along (1), across (4)."""
    x, lon, lat = ca.SX.sym("x", 4), ca.SX.sym("lon"), ca.SX.sym("lat")
    distance = x[3] * ca.fabs(x[3]) / (2 * braking)
    drift = x[1] + distance * ca.sin(x[2])
    across, corner = lat * ca.fabs(ca.cos(x[2])), lon * ca.sin(x[2])
    front = x[0] + along(x[2], lon, lat) + distance
    sides = [drift + across + corner, drift + across - corner, -drift + across + corner, -drift + across - corner]
    values = ca.vertcat(front, *sides)
    return ca.Function("ends", [x, lon, lat], [values, ca.jacobian(values, x)])


def assemble(blocks: list[tuple[ca.SX, ca.SX, ca.SX]], end: ca.SX, scale: ca.DM) -> ca.SX:
    """The constraint matrix in scaled variables."""
    n = len(blocks)
    d = ca.diag(ca.DM(STATE_SCALE))
    inverse = ca.diag(1 / ca.DM(STATE_SCALE))
    rows: list[ca.SX] = []
    slack = ca.SX(-1)
    for k, (jx, ju, soft) in enumerate(blocks):
        before = ca.SX(9 + 8, COLUMNS * k)
        if k:
            dynamics = ca.sparsify(inverse @ jx @ d)
            link = ca.vertcat(dynamics, ca.SX(13, 4))
            before = ca.horzcat(ca.SX(17, COLUMNS * (k - 1) + 2), link, ca.SX(17, 1))
        own = ca.blockcat(
            [
                [ca.sparsify(inverse @ ju @ ca.diag(scale)), -ca.SX.eye(4), ca.SX(4, 1)],
                [ca.SX.eye(2), ca.SX(2, 4), ca.SX(2, 1)],
                [ca.SX(1, 2), _unit(3), ca.SX(1, 1)],
                [ca.SX(1, 2), _unit(2), ca.SX(1, 1)],
                [ca.SX(1, 2), ca.SX(1, 4), ca.SX(1)],
                [ca.SX(8, 2), ca.sparsify(soft @ d), ca.repmat(slack, 8, 1)],
            ]
        )
        rows.append(ca.horzcat(before, own, ca.SX(17, COLUMNS * (n - k - 1))))
    last = ca.horzcat(ca.SX(5, COLUMNS * (n - 1) + 2), ca.sparsify(end @ d), ca.repmat(slack, 5, 1))
    return ca.vertcat(*rows, last)


def _unit(i: int) -> ca.SX:
    out = ca.SX(1, 4)
    out[0, i] = 1
    return out


def objective(
    settings: FilterSettings,
    states: list[ca.SX],
    u: ca.SX,
    curvature: ca.SX,
    aim: ca.SX,
    near: ca.SX,
    weights: ca.SX,
    scale: ca.DM,
) -> tuple[ca.SX, ca.SX]:
    """Upper triangle of the Hessian, and the gradient at the guess."""
    n = settings.stages
    y = ca.SX.sym("y", COLUMNS, n)
    z = y[:2, :] + u / ca.repmat(scale, 1, n)
    cost = ca.dot(weights[:2], (z[:, 0] - near / scale) ** 2)
    for k in range(n):
        dx = y[2:6, k] * ca.DM(STATE_SCALE)
        x = states[k] + dx
        cost += weights[3] * (x[1] - aim[0, k]) ** 2 + weights[4] * x[2] ** 2 + weights[5] * (x[3] - aim[1, k]) ** 2
        cost += settings.penalty * y[6, k]
        if k:
            change = z[:, k] - z[:, k - 1]
            weight = weights[2] if k == 1 else settings.smoothing
            ideal = ca.vertcat(0, feed_forward(curvature[k], aim[0, k]) / scale[1])
            cost += weight * ca.sumsqr(change) + settings.magnitude * ca.sumsqr(z[:, k] - ideal)
    flat = ca.vec(y)
    hessian, gradient = ca.hessian(cost, flat)
    return ca.triu(hessian), ca.substitute(gradient, flat, ca.DM.zeros(COLUMNS * n))
