"""Closed-loop rollouts of the ego, compiled: many candidates over many frames in one CasADi call.

Notation
--------
A *command* per frame is (r*, v*, b): the lateral position of the lane's centre to steer to [m], the speed to
track [m/s], and the greatest deceleration [m/s^2]. The acceleration is

    a = max(KP (v* - v), -b, -max(v, 0) / dt)

so that with b = NO_LIMIT and v* >= 0 it is highway-env's own control, bit for bit in exact arithmetic, and with
v* = BRAKE it brakes at b to a stop and stays there. An *input* per frame is (a, delta): acceleration [m/s^2] and
front wheel angle [rad], with no law in between. On a curved road (see `dynamics.curved`) r* is a line along the
road, and the steering knows its curvature.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import casadi as ca
import numpy as np

from dynamics.bicycle import step_expression
from dynamics.controllers import KP_SPEED, steering_expression
from dynamics.curved import ROW, curved_steering, curved_step, lookup
from dynamics.path import CurvatureProfile, PathRoad
from dynamics.road import StraightRoad
from dynamics.state import FloatArray

__all__ = [
    "BRAKE",
    "NO_LIMIT",
    "Rollouts",
    "curved_frame_function",
    "curved_input_function",
    "frame_function",
    "input_function",
]

BRAKE = -1e9
"""Target speed that stands for braking as hard as the command allows [m/s]."""
NO_LIMIT = 1e12
"""Deceleration bound that stands for none [m/s^2]."""
_Kind = Literal["commands", "inputs"]
_COLUMNS: dict[_Kind, int] = {"commands": 3, "inputs": 2}
_ROWS = (1, 2, 4, 8, 16, 32, 48, 64, 96, 128, 256, 512)
_FRAMES = 8


def frame_function(dt: float) -> ca.Function:
    """One frame: state (4), command (3) -> next state (4)."""
    x, c = ca.SX.sym("x", 4), ca.SX.sym("c", 3)
    a = _acceleration(x, c, dt)
    return ca.Function("frame", [x, c], [step_expression(x, a, steering_expression(x, c[0]), dt)])


def _acceleration(x: ca.SX, c: ca.SX, dt: float) -> ca.SX:
    return ca.fmax(ca.fmax(KP_SPEED * (c[1] - x[3]), -c[2]), -ca.fmax(x[3], 0) / dt)


def input_function(dt: float) -> ca.Function:
    """One frame of the bare bicycle: state (4), input (2) -> next state (4), with highway-env's speed limits."""
    x, u = ca.SX.sym("x", 4), ca.SX.sym("u", 2)
    return ca.Function("input_frame", [x, u], [step_expression(x, u[0], u[1], dt)])


def curved_frame_function(dt: float, road: PathRoad | CurvatureProfile) -> ca.Function:
    """`frame_function` on a curved road: the steering has the path's curvature as feed-forward."""
    x, c, row = ca.SX.sym("x", 4), ca.SX.sym("c", 3), ca.SX.sym("row", ROW)
    step = curved_step(x, _acceleration(x, c, dt), curved_steering(x, c[0], row[1], dt), row, dt)
    return _on_path("curved_frame", ca.Function("step", [x, c, row], [step]), road)


def curved_input_function(dt: float, road: PathRoad | CurvatureProfile) -> ca.Function:
    """`input_function` on a curved road."""
    x, u, row = ca.SX.sym("x", 4), ca.SX.sym("u", 2), ca.SX.sym("row", ROW)
    return _on_path("curved_input_frame", ca.Function("step", [x, u, row], [curved_step(x, u[0], u[1], row, dt)]), road)


def _on_path(name: str, step: ca.Function, road: PathRoad | CurvatureProfile) -> ca.Function:
    profile = road.profile if isinstance(road, PathRoad) else road
    x, u = ca.MX.sym("x", 4), ca.MX.sym("u", step.size1_in(1))
    return ca.Function(name, [x, u], [step(x, u, lookup(profile, x[0]))])


@lru_cache(maxsize=256)
def _compiled(kind: _Kind, rows: int, frames: int, dt: float, profile: CurvatureProfile | None) -> ca.Function:
    if profile is None:
        frame = frame_function(dt) if kind == "commands" else input_function(dt)
    else:
        frame = (curved_frame_function if kind == "commands" else curved_input_function)(dt, profile)
    return frame.mapaccum(frames).map(rows)


class Rollouts:
    """Owns the buffers of the compiled rollouts for one frame duration on one road.

    Parameters
    ----------
    dt : frame duration [s].
    road : the road; its road frame is that of the states. Every straight road has the same rollouts.
    """

    def __init__(self, dt: float, road: StraightRoad | PathRoad | None = None) -> None:
        self.dt = dt
        self._profile = road.profile if isinstance(road, PathRoad) else None
        self._slots: dict[tuple[_Kind, int, int], tuple[FloatArray, FloatArray, FloatArray, _Call]] = {}

    def run(self, state: FloatArray, commands: FloatArray) -> FloatArray:
        """Roll one state under several command sequences.

        Parameters
        ----------
        state : road state, shape (4,), or one for each sequence, (n, 4).
        commands : shape (n, frames, 3).

        Returns
        -------
        Road states after each frame, shape (n, frames, 4).
        """
        return self._roll("commands", state, commands)

    def run_inputs(self, state: FloatArray, inputs: FloatArray) -> FloatArray:
        """Roll one state under several sequences of raw inputs.

        Parameters
        ----------
        state : road state, shape (4,), or one for each sequence, (n, 4).
        inputs : acceleration [m/s^2] and front wheel angle [rad] of each frame, shape (n, frames, 2). They are
            applied as they are; only highway-env's limits above `bicycle.MAX_SPEED` act on the acceleration.

        Returns
        -------
        Road states after each frame, shape (n, frames, 4).
        """
        return self._roll("inputs", state, inputs)

    def _roll(self, kind: _Kind, state: FloatArray, controls: FloatArray) -> FloatArray:
        n, frames, _ = controls.shape
        rows = next((r for r in _ROWS if r >= n), n)
        padded = -(-frames // _FRAMES) * _FRAMES
        x0, c, out, call = self._slot(kind, rows, padded)
        x0[:n] = state
        c[:n, :frames] = controls
        call()
        return out[:n, :frames].copy()

    def _slot(self, kind: _Kind, rows: int, frames: int) -> tuple[FloatArray, FloatArray, FloatArray, _Call]:
        key = (kind, rows, frames)
        if key not in self._slots:
            x0 = np.zeros((rows, 4))
            c, out = np.zeros((rows, frames, _COLUMNS[kind])), np.zeros((rows, frames, 4))
            buffer, call = _compiled(kind, rows, frames, self.dt, self._profile).buffer()
            buffer.set_arg(0, memoryview(x0))  # type: ignore[call-arg, arg-type]
            buffer.set_arg(1, memoryview(c))  # type: ignore[call-arg, arg-type]
            buffer.set_res(0, memoryview(out))  # type: ignore[call-arg, arg-type]
            self._slots[key] = (x0, c, out, _Call(buffer, call))
        return self._slots[key]


class _Call:
    """Keeps the CasADi buffer alive as long as its trigger."""

    __slots__ = ("_buffer", "_call")

    def __init__(self, buffer: object, call: object) -> None:
        self._buffer, self._call = buffer, call

    def __call__(self) -> None:
        self._call()  # type: ignore[operator]
