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
    program.free_sides()
    np.clip(guess, *program.limits, out=program.inputs)
    so_far = _Progress(program.inputs.copy())
    while so_far.sweeps < settings.sweeps:
        if perf_counter() >= deadline:
            so_far.status = Status.TIME_LIMIT
            break
        _sweep(program, solver, so_far)
        if so_far.status is Status.ERROR:
            break
        if program.violation[0] < settings.tolerance:
            wanted = program.wanted
            if wanted is not None and _is_near(program, wanted) and _adopt(program, wanted):
                so_far.change, so_far.exact = 0.0, True
            if so_far.exact and so_far.change < settings.settled:
                break
    return _result(program, so_far)


@dataclass(slots=True, eq=False)
class _Progress:
    """Progress of a descent.

    Attributes
    ----------
    kept, best : the best inputs so far, (N, 2), and their merit.
    exact : whether the last solution is exact. The others as in `Descent`.
    """

    kept: FloatArray
    best: float = np.inf
    exact: bool = True
    status: Status = Status.UNSETTLED
    slack: float = np.inf
    change: float = np.inf
    primal: float = np.inf
    dual: float = np.inf
    active: int = 0
    sweeps: int = 0
    solved: float = 0.0


def _sweep(program: ProblemArrays, solver: QuadraticSolver[Any], so_far: _Progress) -> None:
    """Linearise, solve and step once. The status is an error if there is no solution."""
    moves = len(program.settings.moves)
    program.linearise()
    program.keep_sides()
    if so_far.sweeps == 0:
        so_far.best = program.merit
    mark = perf_counter()
    answer = solver.solve(program)
    so_far.solved += perf_counter() - mark
    so_far.sweeps += 1
    if answer.x is None or not np.isfinite(answer.x).all():
        so_far.status = Status.ERROR
        return
    _step(program, answer.x[: 2 * moves].reshape(-1, 2) * program.scale, so_far)
    so_far.slack, so_far.primal, so_far.dual = max(float(answer.x[2 * moves :].max()), 0.0), answer.primal, answer.dual
    so_far.exact = answer.exact
    so_far.active += answer.active


def _step(program: ProblemArrays, step: FloatArray, so_far: _Progress) -> None:
    """Change the inputs of each move by a step, (moves, 2). If the plan becomes worse than the best so far, go half way
    from the best one."""
    before, scale = program.inputs[0].copy(), program.scale
    program.inputs += np.repeat(step, program.settings.moves, axis=0)
    np.clip(program.inputs, *program.limits, out=program.inputs)
    program.roll_out()
    so_far.change = float(np.abs((program.inputs[0] - before) / scale).max() / 2)
    if so_far.sweeps > 1 and program.merit >= so_far.best:
        program.inputs[:] = 0.5 * (program.inputs + so_far.kept)
        program.roll_out()
        so_far.change = max(so_far.change, float(np.abs((program.inputs[0] - so_far.kept[0]) / scale).max() / 2))
    if program.merit < so_far.best:
        so_far.best, so_far.kept = program.merit, program.inputs.copy()


def _result(program: ProblemArrays, so_far: _Progress) -> Descent:
    """Result of a descent, with the best inputs if it has not converged to a plan."""
    settings, status = program.settings, so_far.status
    settled = so_far.exact and so_far.change < settings.settled
    if status is not Status.ERROR and so_far.sweeps > 0 and not (program.violation[0] < settings.tolerance and settled):
        # Return the best inputs so far; a guess that still satisfies the constraints is a plan.
        program.inputs[:] = so_far.kept
        program.roll_out()
        status = Status.UNSETTLED if program.violation[0] < settings.tolerance else status
    violation = float(program.violation[0])
    if so_far.sweeps == 0 or not (np.isfinite(program.states).all() and np.isfinite(violation)):
        status = Status.ERROR if status is not Status.TIME_LIMIT else status
        violation = np.inf
    elif status is Status.UNSETTLED:
        status = _status_of(violation, so_far.slack, settings.tolerance, settled)
    return Descent(
        status,
        program.inputs.copy(),
        _without_reverse(program),
        program.states.copy(),
        program.sides.copy(),
        so_far.slack,
        violation,
        so_far.change,
        so_far.primal,
        so_far.dual,
        so_far.active,
        so_far.sweeps,
        so_far.solved,
    )


def _is_near(program: ProblemArrays, wanted: FloatArray) -> bool:
    """Whether the first input has all but converged to the proposal."""
    near = 2 * program.settings.settled * program.scale
    return bool((np.abs(program.inputs[0] - wanted) < near).all())


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
