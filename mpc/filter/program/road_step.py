r"""highway-env's bicycle in the frame of a road: one Euler frame, one stage, whole rollouts, as CasADi functions.

Notation
--------
Road state x = (s, r, psi, v) in the order of `dynamics.state.RoadState`, input u = (a, delta): acceleration
[m/s^2], front wheel angle [rad]. kappa [1/m] is the curvature of the road's reference path, positive if the path turns
towards positive r. A *stage* has one input for `substeps` frames of dt.

An Euler step moves the car by (dx, dy) = v dt (cos(psi + beta), sin(psi + beta)) in the tangent frame of the path
at s. On an arc of curvature kappa this straight move is exactly, with R = r + dy and D = 1 - kappa R,

    s'   = s + atan2(kappa dx, D) / kappa
    r'   = (1 - sqrt(D^2 + kappa^2 dx^2)) / kappa = (2 R - kappa (R^2 + dx^2)) / (1 + sqrt(D^2 + kappa^2 dx^2))
    psi' = psi + v sin(beta) / (L/2) dt - kappa (s' - s)

The second form of r' has no singularity at kappa = 0. Source: geometry of a circle and a line, with
`dynamics.vehicle.bicycle.step_expression` for the move.

A `StageModel` computes the move of a whole stage in the tangent frame; the same geometry converts it to the road frame.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Protocol

import casadi as ca

from dynamics.vehicle.bicycle import LENGTH, step_expression

__all__ = ["StageModel", "feed_forward", "frame_expression", "rollout_function", "stage_expression", "without_reverse"]

_STRAIGHT = 1e-12
"""Curvature below which the arc's angle is computed to first order [1/m]."""


class StageModel(Protocol):
    """Model of a stage in place of the bicycle's frames; hashable and immutable."""

    def __hash__(self) -> int: ...

    def held(self, state: ca.SX, control: ca.SX, duration: float) -> ca.SX:
        """(x, y, psi, v) after an input (a, delta) for `duration` [s], (4, 1) to (4, 1).

        Raises
        ------
        ConfigError
            If the model does not support that duration.
        """
        ...


def frame_expression(state: ca.SX, acceleration: ca.SX, steering: ca.SX, curvature: ca.SX | None, dt: float) -> ca.SX:
    """One simulation frame in the road frame, (4, 1) to (4, 1); `curvature` None for a straight road."""
    move = step_expression(ca.vertcat(0, 0, state[2], state[3]), acceleration, steering, dt)
    return _on_road(state, move, curvature)


def _on_road(state: ca.SX, move: ca.SX, curvature: ca.SX | None) -> ca.SX:
    """The road state after a move (dx, dy, psi', v') from (0, 0) in the tangent frame."""
    s, r = state[0], state[1]
    if curvature is None:
        return ca.vertcat(s + move[0], r + move[1], move[2], move[3])
    kappa = ca.if_else(ca.fabs(curvature) < _STRAIGHT, _STRAIGHT, curvature)
    dx, across = move[0], r + move[1]
    to_center = 1 - kappa * across
    along = ca.atan2(kappa * dx, to_center) / kappa
    root = ca.sqrt(to_center * to_center + (kappa * dx) ** 2)
    return ca.vertcat(
        s + along, (2 * across - kappa * (across * across + dx * dx)) / (1 + root), move[2] - kappa * along, move[3]
    )


def stage_expression(
    state: ca.SX,
    control: ca.SX,
    curvature: ca.SX | None,
    dt: float,
    substeps: int,
    model: StageModel | None = None,
) -> ca.SX:
    """`substeps` frames under one input (2, 1), by the bicycle or by a model: state (4, 1) to state (4, 1)."""
    if model is not None:
        move = model.held(ca.vertcat(0, 0, state[2], state[3]), control, dt * substeps)
        return _on_road(state, move, curvature)
    for _ in range(substeps):
        state = frame_expression(state, control[0], control[1], curvature, dt)
    return state


def without_reverse(control: ca.SX, speed: ca.SX, duration: float) -> ca.SX:
    """The input (2, 1), with an acceleration that stops a car of that speed [m/s] but does not drive it backwards."""
    return ca.vertcat(ca.fmax(control[0], -ca.fmax(speed, 0) / duration), control[1])


def feed_forward(curvature: ca.SX, r: ca.SX) -> ca.SX:
    """Front wheel angle [rad] that keeps a car at lateral position r [m] of a path of that curvature [1/m]."""
    bend = curvature / (1 - curvature * r)
    return ca.atan(2 * ca.tan(ca.asin(ca.fmax(ca.fmin(0.5 * LENGTH * bend, 0.7), -0.7))))


@lru_cache(maxsize=32)
def rollout_function(stages: int, substeps: int, dt: float) -> ca.Function:
    """Road states at the end of each stage: (x (4), inputs (2, stages), curvature (stages)) -> states (4, stages)."""
    x, u, k = ca.SX.sym("x", 4), ca.SX.sym("u", 2), ca.SX.sym("k")
    step = ca.Function("stage", [x, u, k], [stage_expression(x, u, k, dt, substeps)])
    return step.mapaccum(stages)
