"""What the predictive filter answers."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from dynamics.state import FloatArray

__all__ = ["FilterResult", "Status"]


class Status(StrEnum):
    """How a `solve` ended; the text says what to do."""

    SOLVED = "solved: verify the plan, then use its first input"
    INACCURATE = "the plan holds but another linearisation may find a nearer one: verify it, or raise sweeps"
    UNSETTLED = "the exact rollout still violates a constraint: use the stored plan, or raise sweeps"
    SLACK = "the constraints cannot all be met on these sides: use the stored plan, or brake"
    TIME_LIMIT = "time limit reached before the plan held: use the stored plan, or raise time_limit or lower sweeps"
    BAD_INPUT = "the problem holds values that are not finite or out of range: repair what built it"
    ERROR = "the solver failed and was rebuilt: use the stored plan; report it if it happens again"

    @property
    def usable(self) -> bool:
        """Whether the plan keeps the constraints by the exact rollout, so that it is worth verifying."""
        return self in (Status.SOLVED, Status.INACCURATE)


@dataclass(frozen=True, slots=True)
class FilterResult:
    """A plan and how good it is. The arrays are the caller's own.

    Attributes
    ----------
    status : how it ended. No plan was verified frame by frame: that is the caller's part.
    inputs : (a [m/s^2], delta [rad]) of each stage, (N, 2), inside the bounds; NaN where there is no plan.
    states : road states at the end of each stage by the exact rollout of `inputs`, (N, 4).
    sides : on which `Side` the plan was to pass each obstacle at each stage, (N, m); -1 where there is no plan.
    slack : greatest slack that the last quadratic program had to use [m].
    violation : greatest violation of a constraint by `states` [m], whichever side an obstacle is passed on.
    change : of the first input by the last linearisation, as a share of the range; 0 where it is the proposal.
    primal, dual : residuals of the last quadratic program, computed here and not by the solver.
    active : bounds and rows that hold with equality, all quadratic programs together: the solver's work.
    sweeps : linearisations made.
    restarted : whether the guess led nowhere, so that the braking guess was tried as well.
    build_time, solve_time : spent around the quadratic programs and on their solutions [s].
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
    active: int
    sweeps: int
    restarted: bool
    build_time: float
    solve_time: float
