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
from typing import Any, Literal

import casadi as ca
import numpy as np

from dynamics.bicycle import Columns, slip_of, slip_step
from dynamics.controllers import KP_SPEED, slip_expression
from dynamics.curved import curved_slip, curved_step, lookup
from dynamics.path import CurvatureProfile, PathRoad
from dynamics.road import StraightRoad
from dynamics.state import FloatArray

__all__ = ["BRAKE", "MANY", "NO_LIMIT", "Bound", "Rollouts", "frame_function", "padded_rows"]

BRAKE = -1e9
"""Target speed that stands for braking as hard as the command allows [m/s]."""
NO_LIMIT = 1e12
"""Deceleration bound that stands for none [m/s^2]."""
_Kind = Literal["commands", "inputs"]
_OPTIONS = {"cse": True}
_COLUMNS: dict[_Kind, int] = {"commands": 3, "inputs": 2}
_ROWS = (1, 2, 4, 8, 16, 24, 32, 48, 64, 96, 128, 256, 512)
_FRAMES = 16
MANY = 4
"""From how many rows on they are rolled out as columns."""


@lru_cache(maxsize=256)
def _compiled(kind: _Kind, rows: int, frames: int, dt: float, profile: CurvatureProfile | None) -> ca.Function:
    if rows < MANY:
        return frame_function(kind, 1, dt, profile).mapaccum(frames).map(rows)
    return frame_function(kind, rows, dt, profile).mapaccum(frames)


def frame_function(kind: _Kind, rows: int, dt: float, profile: CurvatureProfile | None = None) -> ca.Function:
    """One frame of `rows` vehicles: states (rows, 4), commands (rows, 3) or inputs (rows, 2) -> states (rows, 4).

    A single one is (4, 1) to (4, 1), as scalars. CasADi interprets its programs: with columns, each instruction serves
    all rows. On the path of `profile`, where one is given, the steering has the path's curvature as feed-forward.
    """
    count = _COLUMNS[kind]
    state: tuple[Any, ...]
    control: tuple[Any, ...]
    if rows > 1:
        x, c = ca.MX.sym("x", rows, 4), ca.MX.sym("c", rows, count)
        state, control = tuple(x[:, i] for i in range(4)), tuple(c[:, i] for i in range(count))
        row = None if profile is None else lookup(profile, state[0])
        return ca.Function("frame", [x, c], [ca.horzcat(*_frame(kind, state, control, row, dt))], _OPTIONS)
    one, u, found = ca.SX.sym("x", 4), ca.SX.sym("c", count), ca.SX.sym("row", 5)
    state, control = tuple(one[i] for i in range(4)), tuple(u[i] for i in range(count))
    if profile is None:
        return ca.Function("frame", [one, u], [ca.vertcat(*_frame(kind, state, control, None, dt))], _OPTIONS)
    step = ca.vertcat(*_frame(kind, state, control, tuple(found[i] for i in range(5)), dt))
    x, c = ca.MX.sym("x", 4), ca.MX.sym("c", count)
    after = ca.Function("step", [one, u, found], [step], _OPTIONS)(x, c, ca.vertcat(*lookup(profile, x[0])))
    return ca.Function("frame", [x, c], [after])


def _frame(kind: _Kind, state: Any, control: Any, row: Any, dt: float) -> Columns:
    if kind == "inputs":
        acceleration, slip = control[0], slip_of(control[1])
    else:
        v = state[3]
        acceleration = ca.fmax(ca.fmax(KP_SPEED * (control[1] - v), -control[2]), ca.fmax(v, 0) * (-1 / dt))
        slip = slip_expression(state, control[0]) if row is None else curved_slip(state, control[0], row[1], dt)
    if row is None:
        return slip_step(state, acceleration, slip, dt)
    return curved_step(state, acceleration, slip, row, dt)


def padded_rows(n: int) -> int:
    """How many rows a rollout of n is compiled for."""
    return next((r for r in _ROWS if r >= n), n)


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
        self._slots: dict[tuple[_Kind, int, int], Bound] = {}

    def prepare(self, rows: tuple[int, ...], inputs: int, commands: int) -> None:
        """Compile ahead of the first use: for that many frames of inputs, and up to that many frames of commands."""
        for n in map(padded_rows, rows):
            self._slot("inputs", n, inputs)
            for frames in range(_FRAMES, commands + _FRAMES, _FRAMES):
                self._slot("commands", n, frames)

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
        # Commands go on until the ego stands, for ever other numbers of frames; inputs are held for a fixed one.
        padded = frames if kind == "inputs" else -(-frames // _FRAMES) * _FRAMES
        bound = self._slot(kind, padded_rows(n), padded)
        bound.start[:n] = state
        bound.controls[:n, :frames] = controls
        bound()
        return bound.paths[:n, :frames].copy()

    def _slot(self, kind: _Kind, rows: int, frames: int) -> Bound:
        key = (kind, rows, frames)
        if key not in self._slots:
            function = _compiled(kind, rows, frames, self.dt, self._profile)
            self._slots[key] = Bound(function, rows, frames, _COLUMNS[kind], frames)
        return self._slots[key]


class Bound:
    """A compiled rollout and the arrays that it reads and writes.

    Parameters
    ----------
    function : start and controls to paths, its last result; from `MANY` rows on as columns.
    rows, steps, columns : of the controls.
    frames : of the paths.

    Attributes
    ----------
    start (rows, 4), controls (rows, steps, columns), paths (rows, frames, 4) : views of the arrays.
    """

    __slots__ = ("_buffer", "_call", "controls", "paths", "start")

    def __init__(self, function: ca.Function, rows: int, steps: int, columns: int, frames: int) -> None:
        wide = rows >= MANY
        start = np.zeros((4, rows) if wide else (rows, 4))
        controls = np.zeros((steps, columns, rows) if wide else (rows, steps, columns))
        paths = np.zeros((frames, 4, rows) if wide else (rows, frames, 4))
        self._buffer, self._call = function.buffer()
        self._buffer.set_arg(0, memoryview(start))  # type: ignore[call-arg, arg-type]
        self._buffer.set_arg(1, memoryview(controls))  # type: ignore[call-arg, arg-type]
        self._buffer.set_res(function.n_out() - 1, memoryview(paths))  # type: ignore[call-arg, arg-type]
        if wide:
            start, controls, paths = start.T, controls.transpose(2, 0, 1), paths.transpose(2, 0, 1)
        self.start, self.controls, self.paths = start, controls, paths

    def __call__(self) -> None:
        self._call()  # type: ignore[operator]
