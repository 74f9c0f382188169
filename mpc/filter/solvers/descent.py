"""Descent from a guess to a plan: linearise, solve and roll out, until the first input has converged."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from dynamics.state import FloatArray, RoadState
from mpc.filter.program.question import ProblemArrays
from mpc.filter.result import Status
from mpc.filter.solvers.daqp import QuadraticSolver

__all__ = ["Descent", "descend"]

_STILL = 1e-9
"""Backward speed up to which rounding is the cause [m/s]."""


@dataclass(frozen=True, slots=True)
class Descent:
    """Result of a descent.

    Attributes as in `FilterResult`; `guess` are the inputs before braking ends at a standstill, (N, 2), and `solved` is
    the time spent in the solver [s].
    """

    status: Status
    guess: FloatArray
    inputs: FloatArray
    states: FloatArray
    sides: FloatArray
    slack: float
    violation: float
    change: float
    primal: float
    dual: float
    active: int
    sweeps: int
    solved: float

    @property
    def rank(self) -> tuple[bool, float]:
        """Rank of the result, better if smaller: usable plans first, then by violation."""
        return not self.status.usable, self.violation


def descend(program: ProblemArrays, solver: QuadraticSolver[Any], guess: FloatArray, deadline: float) -> Descent:
    """Improve a guess (N, 2) by at most `settings.sweeps` linearisations, with the sides of the guess.

    Steps are full, because the next linearisation corrects the errors of the last one. A step to a worse plan than the
    best so far is reduced to half way from the best one. The best plan is returned, so a guess that satisfies the
    constraints is never lost.

    Parameters
    ----------
    program : the program, filled with the problem.
    solver : solver of the quadratic programs.
    guess : inputs; they are clipped to the bounds.
    deadline : value of `perf_counter` after which no further linearisation begins [s]; inf for none.
    """
    settings = program.settings
    low, high = program.limits
    moves = np.repeat(np.arange(len(settings.moves)), settings.moves)
    program.free_sides()
    np.clip(guess, low, high, out=program.inputs)
    wanted, near = program.wanted, 2 * settings.settled * program.scale
    slack = change = primal = dual = np.inf
    active, sweeps, solved, best, exact = 0, 0, 0.0, np.inf, True
    kept = program.inputs.copy()
    status = Status.UNSETTLED
    while sweeps < settings.sweeps:
        if perf_counter() >= deadline:
            status = Status.TIME_LIMIT
            break
        program.linearise()
        program.keep_sides()
        if sweeps == 0:
            best = program.merit
        mark = perf_counter()
        answer = solver.solve(program)
        solved += perf_counter() - mark
        sweeps += 1
        if answer.x is None or not np.isfinite(answer.x).all():
            status = Status.ERROR
            break
        step = answer.x[: 2 * len(settings.moves)].reshape(-1, 2)
        before = program.inputs[0].copy()
        program.inputs += (step * program.scale)[moves]
        np.clip(program.inputs, low, high, out=program.inputs)
        program.roll_out()
        change = float(np.abs((program.inputs[0] - before) / program.scale).max() / 2)
        if sweeps > 1 and program.merit >= best:
            program.inputs[:] = 0.5 * (program.inputs + kept)
            program.roll_out()
            change = max(change, float(np.abs((program.inputs[0] - kept[0]) / program.scale).max() / 2))
        if program.merit < best:
            best, kept = program.merit, program.inputs.copy()
        slack, primal, dual = max(float(answer.x[step.size :].max()), 0.0), answer.primal, answer.dual
        exact = answer.exact
        active += answer.active
        if program.violation[0] < settings.tolerance:
            if (
                wanted is not None
                and bool((np.abs(program.inputs[0] - wanted) < near).all())
                and _adopt(program, wanted)
            ):
                change, exact = 0.0, True
            if exact and change < settings.settled:
                break
    holds, settled = program.violation[0] < settings.tolerance, exact and change < settings.settled
    if status is not Status.ERROR and sweeps > 0 and not (holds and settled):
        # Return the best inputs so far; a guess that still satisfies the constraints is a plan.
        program.inputs[:] = kept
        program.roll_out()
        status = Status.UNSETTLED if program.violation[0] < settings.tolerance else status
    violation = float(program.violation[0])
    if sweeps == 0 or not (np.isfinite(program.states).all() and np.isfinite(violation)):
        status = Status.ERROR if status is not Status.TIME_LIMIT else status
        violation = np.inf
    elif status is Status.UNSETTLED:
        status = _status_of(violation, slack, settings.tolerance, settled)
    return Descent(
        status,
        program.inputs.copy(),
        _without_reverse(program),
        program.states.copy(),
        program.sides.copy(),
        slack,
        violation,
        change,
        primal,
        dual,
        active,
        sweeps,
        solved,
    )


def _adopt(program: ProblemArrays, wanted: FloatArray) -> bool:
    """Use the proposal itself as the first input, if the plan satisfies the constraints with it.

    The second input compensates the difference, so that the rest of the plan stays the same.

    Returns
    -------
    Whether the proposal was adopted; otherwise the inputs are restored.
    """
    before = program.inputs[:2].copy()
    low, high = program.limits
    program.inputs[0] = wanted
    program.inputs[1] = np.clip(before[1] + before[0] - wanted, low, high)
    program.roll_out()
    if program.violation[0] < program.settings.tolerance and program.states[:, RoadState.SPEED].min() >= -_STILL:
        return True
    program.inputs[:2] = before
    program.roll_out()
    return False


def _without_reverse(program: ProblemArrays) -> FloatArray:
    """The inputs that are executed (N, 2): braking in a stage ends at a standstill."""
    inputs, duration = program.inputs.copy(), program.settings.dt * np.array(program.settings.frames)
    speeds = np.concatenate([program.state[RoadState.SPEED :], program.states[:-1, RoadState.SPEED]])
    inputs[:, 0] = np.maximum(inputs[:, 0], -np.maximum(speeds, 0.0) / duration)
    return inputs


def _status_of(violation: float, slack: float, tolerance: float, settled: bool) -> Status:
    if violation >= tolerance:
        return Status.SLACK if slack >= tolerance else Status.UNSETTLED
    return Status.SOLVED if settled else Status.INACCURATE
