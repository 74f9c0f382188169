"""Result of the predictive filter."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from dynamics.state import FloatArray

__all__ = ["FilterResult", "Status"]


class Status(StrEnum):
    """Status of a `solve`; the text contains the advice."""

    SOLVED = "solved: verify the plan, then use its first input"
    INACCURATE = "the plan holds but another linearisation may find a nearer one: verify it, or raise sweeps"
    UNSETTLED = "the exact rollout still violates a constraint: use the stored plan, or raise sweeps"
    SLACK = "the constraints cannot all be met on these sides: use the stored plan, or brake"
    TIME_LIMIT = "time limit reached before the plan held: use the stored plan, or raise time_limit or lower sweeps"
    BAD_INPUT = "the problem holds values that are not finite or out of range: repair what built it"
    ERROR = "the solver failed and was rebuilt: use the stored plan; report it if it happens again"

    @property
    def usable(self) -> bool:
        """Whether the plan satisfies the constraints in the exact rollout, so that it is worth verifying."""
        return self in (Status.SOLVED, Status.INACCURATE)


@dataclass(frozen=True, slots=True)
class FilterResult:
    """A plan and its quality. The arrays belong to the caller.

    Attributes
    ----------
    status : the status. The plan is not verified frame by frame; that is the caller's task.
    inputs : (a [m/s^2], delta [rad]) of each stage, (N, 2), inside the bounds; NaN without a plan.
    states : road states at the end of each stage by the exact rollout of `inputs`, (N, 4).
    sides : `Side` on which the plan passes each obstacle at each stage, (N, m); -1 without a plan.
    slack : greatest slack in the last quadratic program [m].
    violation : greatest violation of a constraint by `states` [m], for any side of an obstacle.
    change : change of the first input by the last linearisation, as a share of the range; 0 for the proposal itself.
    primal, dual : residuals of the last quadratic program, computed independently of the solver.
    active : number of active bounds and rows in all quadratic programs together, a measure of the solver's work.
    sweeps : number of linearisations.
    restarted : whether the guess led to no usable plan, so that the braking guess was tried as well.
    build_time, solve_time : time around the quadratic programs and for their solutions [s].
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
