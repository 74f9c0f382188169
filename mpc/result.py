"""What the predictive filter answers."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from dynamics.state import FloatArray

__all__ = ["FilterResult", "Status"]


class Status(StrEnum):
    """How a `solve` ended; the text says what to do."""

    SOLVED = "solved: verify the plan, then use its first input"
    INACCURATE = "solved to a loose accuracy: verify the plan, or raise max_iter"
    SLACK = "the constraints cannot all be met from here: use the stored plan, or brake"
    MAX_ITER = "iteration limit reached: use the stored plan, or raise max_iter or shorten the horizon"
    TIME_LIMIT = "time limit reached: use the stored plan, or raise time_limit or lower sweeps"
    BAD_INPUT = "the problem holds values that are not finite or out of range: repair what built it"
    ERROR = "the solver failed and was rebuilt: use the stored plan; report it if it happens again"

    @property
    def usable(self) -> bool:
        """Whether there is a plan that is worth verifying."""
        return self in (Status.SOLVED, Status.INACCURATE, Status.MAX_ITER, Status.TIME_LIMIT)


@dataclass(frozen=True, slots=True)
class FilterResult:
    """A plan and how good it is. The arrays are the caller's own.

    Attributes
    ----------
    status : how it ended. No plan was verified frame by frame: that is the caller's part.
    inputs : (a [m/s^2], delta [rad]) of each stage, (N, 2), inside the bounds; NaN where there is no plan.
    states : road states at the end of each stage by the exact rollout of `inputs`, (N, 4).
    sides : on which `Side` the plan passes each obstacle at each stage, (N, m).
    slack : greatest slack that the last quadratic program had to use [m].
    violation : greatest violation of a constraint by `states` [m], whichever side is counted; 0 for none.
    change : greatest change of the first input in the last linearisation, as a share of the range.
    primal, dual : residuals of the last quadratic program, computed here and not by the solver (scaled variables).
    iterations : of the solver, all sweeps together.
    sweeps : linearisations made.
    build_time, solve_time : spent on the quadratic programs' data and on their solutions [s].
    """

    status: Status
    inputs: FloatArray
    states: FloatArray
    sides: FloatArray
    slack: float
    violation: float
    change: float
    primal: float
    dual: float
    iterations: int
    sweeps: int
    build_time: float
    solve_time: float
