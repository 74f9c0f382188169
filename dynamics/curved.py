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
from dynamics.bicycle import LENGTH, Columns, slip_step
from dynamics.controllers import (
    KP_HEADING,
    KP_LATERAL,
    MAX_SLIP,
    clip_expression,
    nonzero_expression,
    steering_control,
    wrap_expression,
)
from dynamics.path import CurvatureProfile
from dynamics.state import FloatArray

__all__ = ["Row", "curved_slip", "curved_step", "lookup", "steer", "steering_function"]

Row = tuple[Any, Any, Any, Any, Any]
"""What `lookup` finds: curvature before, here and after [1/m], way to the piece's start and end [m]."""
_FAR = 1e9
"""Where an open path's first and last piece begin and end [m]."""
_NEAREST = 0.1
"""Least share of the radius of a bend at which its centre is taken to be."""
_MAX_SLIP = 0.7
"""Greatest sine of the slip angle that is asked for in advance; the wheel's limit allows 0.65."""


def lookup(profile: CurvatureProfile, s: Any) -> Row:
    """The row of the path's table at arc lengths s [m], a scalar or a column (MX)."""
    breaks, k = np.array(profile.breaks), np.array(profile.curvatures)
    starts, ends = breaks[:-1].copy(), breaks[1:].copy()
    before, after = np.roll(k, 1), np.roll(k, -1)
    if not profile.closed:
        starts[0], ends[-1], before[0], after[-1] = -_FAR, _FAR, k[0], k[-1]
    within = s - breaks[-1] * ca.floor(s / breaks[-1]) if profile.closed else s
    index = ca.low(ca.DM(breaks), within)
    found = [ca.MX(ca.DM(c))[index] if k.size > 1 else ca.MX(c[0]) for c in (before, k, after, starts, ends)]
    return found[0], found[1], found[2], found[3] - within, found[4] - within


def curved_step(state: Columns, acceleration: Any, slip: Any, row: Row, dt: float) -> Columns:
    """One simulation frame in road states, element by element; `row` is that of `lookup` at their s."""
    s, r, psi, v = state
    x, y, heading, speed = slip_step((0, r, psi, v), acceleration, slip, dt)
    before, k, after, start, end = row
    first, _ = _project(x, y, k)
    ahead, behind = first > end, first < start
    joint = ahead * end + behind * start
    # a start that rounding puts just outside its piece makes no difference: then the joint is where it stands
    next_k = _choose(ahead, after, _choose(behind, before, k))
    turn = k * joint
    cos, sin = ca.cos(turn), ca.sin(turn)
    bent = ca.fabs(k) >= STRAIGHT
    safe = _choose(bent, k, 1)
    dx = x - _choose(bent, sin / safe, joint)
    dy = y - bent * (2 * ca.sin(turn / 2) ** 2) / safe
    along, across = _project(cos * dx + sin * dy, cos * dy - sin * dx, next_k)
    return s + joint + along, across, heading - turn - next_k * along, speed


def curved_slip(state: Columns, target_r: Any, k: Any, dt: float) -> Any:
    """Sine of the slip angle that leads road states to lateral position `target_r` [m], element by element.

    The path has curvature k [1/m] at s, a frame lasts dt [s]. At k = 0 it is `controllers.slip_expression`.
    """
    _, r, psi, v = state
    v = nonzero_expression(v)
    kappa = k / ca.fmax(1 - k * r, _NEAREST)
    bend = clip_expression(LENGTH / 2 * kappa, _MAX_SLIP)
    chord = clip_expression(kappa * v * (dt / 2), _MAX_SLIP)
    heading_ref = ca.asin(clip_expression(KP_LATERAL * (target_r - r) / v, np.sin(np.pi / 4))) + chord - ca.asin(bend)
    return clip_expression((LENGTH / 2 * KP_HEADING) * wrap_expression(heading_ref - psi) / v + bend, MAX_SLIP)


@lru_cache(maxsize=64)
def steering_function(profile: CurvatureProfile, dt: float) -> ca.Function:
    """Road state (4), target r -> wheel angle [rad]: the law of `curved_slip` anywhere on a path."""
    x, r = ca.MX.sym("x", 4), ca.MX.sym("r")
    slip = curved_slip((x[0], x[1], x[2], x[3]), r, lookup(profile, x[0])[1], dt)
    return ca.Function("steering", [x, r], [ca.atan(2 * ca.tan(ca.asin(slip)))])


def steer(road: Any, state: FloatArray, r: float, dt: float) -> float:
    """Wheel angle [rad] that leads a road state (4,) to lateral position `r` [m] on any road."""
    if road.bends is None:
        return float(steering_control(state, r))
    return float(steering_function(road.profile, dt)(state, r))


def _choose(condition: Any, then: Any, otherwise: Any) -> Any:
    """Element by element; both must be finite."""
    return condition * then + (1 - condition) * otherwise


def _project(x: Any, y: Any, k: Any) -> tuple[Any, Any]:
    """`arcs.project` in the frame of the path."""
    rest, bent = 1 - k * y, ca.fabs(k) >= STRAIGHT
    s = _choose(bent, ca.atan2(k * x, rest) / _choose(bent, k, 1), x)
    r = (2 * y - k * (x * x + y * y)) / (1 + ca.sqrt(rest * rest + (k * x) ** 2))
    return s, r
