r"""highway-env's bicycle and lane keeping in the frame of a curved road, as CasADi expressions.

Notation
--------
Road state (s, r, psi, v), curvature k [1/m] at s. An Euler step moves the vehicle along a straight line,
(dx, dy) = v dt (cos(psi + beta), sin(psi + beta)) in the frame of the path at s. On one arc, with Y = r + dy and
D = 1 - k Y, that is exactly

    s'   = s + atan2(k dx, D) / k
    r'   = (2 Y - k (Y^2 + dx^2)) / (1 + sqrt(D^2 + k^2 dx^2))
    psi' = psi + v sin(beta) / (L/2) dt - k (s' - s)

A step that ends beyond a joint of the path is projected again, on the arc behind the joint: exact too, as long as it
crosses one joint (a step shorter than every piece does). If it crosses another, the piece behind that is taken for a
continuation: the heading is then wrong by |dk| c and the position by |dk| c^2 / 2, to first order, with c the distance
driven beyond the second joint and dk the change of curvature there.

Source: geometry (`dynamics.arcs`) and `dynamics.bicycle`; the law is `dynamics.controllers` with the slip angle that
a bend of radius 1/kappa asks for: sin(beta) = kappa L / 2 with kappa = k / (1 - k r), at psi = kappa v dt / 2 - beta.
(An Euler step goes along a chord of the bend, which points inwards by half of the angle that it spans.)
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from dynamics.arcs import STRAIGHT
from dynamics.bicycle import LENGTH, step_expression
from dynamics.controllers import KP_HEADING, KP_LATERAL, MAX_STEERING, steering_control
from dynamics.path import CurvatureProfile
from dynamics.state import FloatArray

__all__ = ["ROW", "curved_steering", "curved_step", "lookup", "steer", "steering_function"]

ROW = 5
"""Size of what `lookup` finds: curvature before, here and after [1/m], way to the piece's start and end [m]."""
_FAR = 1e9
"""Where an open path's first and last piece begin and end [m]."""
_NEAREST = 0.1
"""Least share of the radius of a bend at which its centre is taken to be."""
_MAX_SLIP = 0.7
"""Greatest sine of the slip angle that is asked for in advance; the wheel's limit allows 0.65."""
_NONZERO = 1e-2


def lookup(profile: CurvatureProfile, s: ca.MX) -> ca.MX:
    """The row (`ROW`,) of the path's table at arc length s [m]."""
    breaks, k = np.array(profile.breaks), np.array(profile.curvatures)
    starts, ends = breaks[:-1].copy(), breaks[1:].copy()
    before, after = np.roll(k, 1), np.roll(k, -1)
    if not profile.closed:
        starts[0], ends[-1], before[0], after[-1] = -_FAR, _FAR, k[0], k[-1]
    table = ca.MX(ca.DM(np.stack([before, k, after, starts, ends])))
    within = s - breaks[-1] * ca.floor(s / breaks[-1]) if profile.closed else s
    row = table[:, ca.low(ca.DM(breaks), within)] if k.size > 1 else table
    return ca.vertcat(row[:3], row[3:] - within)


def curved_step(state: ca.SX, acceleration: ca.SX, steering: ca.SX, row: ca.SX, dt: float) -> ca.SX:
    """One simulation frame, road state (4, 1) to road state (4, 1); `row` is that of `lookup` at its s."""
    move = step_expression(ca.vertcat(0, state[1], state[2], state[3]), acceleration, steering, dt)
    k = row[1]
    first, _ = _project(move[0], move[1], k)
    ahead, behind = first > row[4], first < row[3]
    joint = ca.if_else(ahead, row[4], ca.if_else(behind, row[3], 0))
    # a start that rounding puts just outside its piece makes no difference: then the joint is where it stands
    next_k = ca.if_else(ahead, row[2], ca.if_else(behind, row[0], k))
    turn = k * joint
    bent = ca.fabs(k) >= STRAIGHT
    safe = ca.if_else(bent, k, 1)
    jx = ca.if_else(bent, ca.sin(turn) / safe, joint)
    jy = ca.if_else(bent, 2 * ca.sin(turn / 2) ** 2 / safe, 0)
    dx, dy = move[0] - jx, move[1] - jy
    cos, sin = ca.cos(turn), ca.sin(turn)
    along, across = _project(cos * dx + sin * dy, cos * dy - sin * dx, next_k)
    return ca.vertcat(state[0] + joint + along, across, move[2] - turn - next_k * along, move[3])


def curved_steering(state: ca.SX, target_r: ca.SX, k: ca.SX, dt: float) -> ca.SX:
    """Wheel angle [rad] that leads a road state (4, 1) to lateral position `target_r` [m].

    The path has curvature k [1/m] at s, a frame lasts dt [s].

    At k = 0 it is `controllers.steering_expression`.
    """

    def clip(x: ca.SX, bound: float) -> ca.SX:
        return ca.fmin(ca.fmax(x, -bound), bound)

    r, psi, v = state[1], state[2], state[3]
    v = ca.if_else(ca.fabs(v) > _NONZERO, v, ca.if_else(v >= 0, ca.SX(_NONZERO), ca.SX(-_NONZERO)))
    kappa = k / ca.fmax(1 - k * r, _NEAREST)
    bend = clip(LENGTH / 2 * kappa, _MAX_SLIP)
    chord = clip(kappa * v * dt / 2, _MAX_SLIP)
    heading_ref = clip(ca.asin(clip(-KP_LATERAL * (r - target_r) / v, 1.0)), np.pi / 4) + chord - ca.asin(bend)
    error = heading_ref - psi
    error = error - 2 * np.pi * ca.floor((error + np.pi) / (2 * np.pi))
    slip = ca.asin(clip(LENGTH / 2 / v * KP_HEADING * error + bend, 1.0))
    return clip(ca.atan(2 * ca.tan(slip)), MAX_STEERING)


@lru_cache(maxsize=64)
def steering_function(profile: CurvatureProfile, dt: float) -> ca.Function:
    """Road state (4), target r -> wheel angle: `curved_steering` anywhere on a path."""
    x, r, k = ca.SX.sym("x", 4), ca.SX.sym("r"), ca.SX.sym("k")
    law = ca.Function("law", [x, r, k], [curved_steering(x, r, k, dt)])
    state, goal = ca.MX.sym("x", 4), ca.MX.sym("r")
    return ca.Function("steering", [state, goal], [law(state, goal, lookup(profile, state[0])[1])])


def steer(road: Any, state: FloatArray, r: float, dt: float) -> float:
    """Wheel angle [rad] that leads a road state (4,) to lateral position `r` [m] on any road."""
    if road.bends is None:
        return float(steering_control(state, r))
    return float(steering_function(road.profile, dt)(state, r))


def _project(x: ca.SX, y: ca.SX, k: ca.SX) -> tuple[ca.SX, ca.SX]:
    """`arcs.project` in the frame of the path."""
    rest, bent = 1 - k * y, ca.fabs(k) >= STRAIGHT
    s = ca.if_else(bent, ca.atan2(k * x, rest) / ca.if_else(bent, k, 1), x)
    r = (2 * y - k * (x * x + y * y)) / (1 + ca.sqrt(rest * rest + (k * x) ** 2))
    return s, r
