"""Arrays of one problem and its guess, which the compiled functions read and write."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from dynamics.state import FloatArray
from mpc.filter.problem import FREE, FilterProblem, FilterSettings, Occupied
from mpc.filter.program.linearised import MISC

__all__ = ["ProblemArrays", "Weights", "bind"]


@dataclass(frozen=True, slots=True)
class Weights:
    """Weights of one problem, in the order of the compiled function."""

    acceleration: float
    steering: float
    first: float
    lateral: float
    heading: float
    speed: float

    @classmethod
    def of(cls, problem: FilterProblem, settings: FilterSettings) -> Weights:
        """Weights of a problem; with a proposal, the first input has no smoothing."""
        near = problem.proposal is not None
        aim = problem.reference
        lateral, heading, speed = (aim.lateral, aim.heading, aim.speed) if aim is not None else (0.0, 0.0, 0.0)
        return cls(float(near), float(near), 0.0 if near else settings.smoothing, lateral, heading, speed)


class ProblemArrays:
    """Arrays of one compiled size: fill the inputs, call `linearise`, and read the outputs.

    Subclasses define the form of the quadratic program: `condensed.Program` and `sparse.SparseProgram`.

    Attributes
    ----------
    state (4,), inputs (N, 2), occupancy (N, m, 4), rest (m,), edges (N, 2), corridor (N, 2), curvature (N,),
    aim (N, 2), misc (15,), given (N, m) : inputs. misc is lon, lat, stop, proposal (2), limits (4), weights (6). given
        is a side, or -1 for a free choice.
    states (N, 4), sides (N, m), violation (1,), cost (1,) : values of the guess, by the exact rollout.
    scale : half the range of the inputs, (2,).
    """

    def __init__(
        self, settings: FilterSettings, m: int, function: ca.Function, rollout: ca.Function, program: tuple[Any, ...]
    ) -> None:
        n = settings.stages
        self.settings = settings
        self.state, self.inputs = np.zeros(4), np.zeros((n, 2))
        self.occupancy, self.rest = np.full((n, m, 4), FREE), np.full(m, FREE)
        self.edges, self.corridor = np.tile([-FREE, FREE], (n, 1)), np.tile([-FREE, FREE], (n, 1))
        self.curvature, self.aim, self.misc = np.zeros(n), np.zeros((n, 2)), np.zeros(MISC)
        self.states, self.sides, self.given = np.zeros((n, 4)), np.zeros((n, m)), np.full((n, m), -1.0)
        self.violation, self.cost = np.zeros(1), np.zeros(1)
        self.scale = np.array([0.5 * (settings.acceleration[1] - settings.acceleration[0]), settings.steering])
        arguments = (self.state, self.inputs, self.occupancy, self.rest, self.edges, self.corridor, self.curvature)
        given = (*arguments, self.aim, self.misc, self.given)
        self._linearise = bind(function, given, (*program, self.states, self.sides, self.violation, self.cost))
        self._roll_out = bind(rollout, given, (self.states, self.violation, self.cost))

    def fill(self, problem: FilterProblem, settings: FilterSettings) -> None:
        """Fill all inputs except the guess, `inputs`."""
        m = int(problem.occupancy.shape[1])
        self.state[:] = problem.state
        np.clip(problem.occupancy, -FREE, FREE, out=self.occupancy[:, :m])
        self.occupancy[:, m:] = FREE
        ends = problem.occupancy[-1, :, Occupied.S_MIN] if problem.rest is None else problem.rest
        np.clip(ends, -FREE, FREE, out=self.rest[:m])
        self.rest[m:] = FREE
        for target, pair in ((self.edges, problem.edges), (self.corridor, problem.corridor)):
            target[:, 0], target[:, 1] = pair
        np.clip(self.edges, -FREE, FREE, out=self.edges)
        np.clip(self.corridor, -FREE, FREE, out=self.corridor)
        if problem.curvature is not None:
            self.curvature[:] = problem.curvature
        aim = problem.reference
        self.aim[:, 0], self.aim[:, 1] = (aim.r, aim.v) if aim is not None else (0.0, 0.0)
        weights = Weights.of(problem, settings)
        near = problem.proposal if problem.proposal is not None else (0.0, 0.0)
        limits = np.array([settings.acceleration, (-settings.steering, settings.steering)])
        if problem.limits is not None:
            limits = np.asarray(problem.limits, dtype=float)
        self.misc[:] = (
            *problem.half,
            min(problem.stop, FREE),
            *near,
            *limits.ravel(),
            weights.acceleration,
            weights.steering,
            weights.first,
            weights.lateral,
            weights.heading,
            weights.speed,
        )

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """Least and greatest input, (2,) each."""
        return self.misc[5:9:2], self.misc[6:9:2]

    @property
    def wanted(self) -> FloatArray | None:
        """The valid input nearest to the proposal, (2,); None with a reference."""
        if self.misc[9] == 0 or self.misc[12:15].any():
            return None
        return np.clip(self.misc[3:5], *self.limits)

    @property
    def merit(self) -> float:
        """Merit function: cost of `inputs` plus their violation beyond the tolerance, which a step has to lower."""
        return float(self.cost[0] + self.settings.penalty * max(self.violation[0] - self.settings.tolerance, 0.0))

    def free_sides(self) -> None:
        """Choose the sides anew for each guess."""
        self.given[:] = -1.0

    def keep_sides(self) -> None:
        """Keep the sides of the last call."""
        self.given[:] = self.sides

    def linearise(self) -> None:
        """Linearise about the rollout of `inputs`, and fill every output."""
        self._linearise()

    def roll_out(self) -> None:
        """Roll out `inputs`, and fill `states`, `violation` and `cost` only."""
        self._roll_out()


def bind(
    function: ca.Function, arguments: tuple[FloatArray, ...], results: tuple[FloatArray, ...]
) -> Callable[[], None]:
    """A call of the function that reads and writes these arrays in place, without copies or conversions."""
    buffer, call = function.buffer()
    for i, array in enumerate(arguments):
        buffer.set_arg(i, memoryview(array.reshape(-1, order="A")))  # type: ignore[call-arg, arg-type]
    for i, array in enumerate(results):
        buffer.set_res(i, memoryview(array.reshape(-1, order="A")))  # type: ignore[call-arg, arg-type]

    def run(keep: tuple[Any, ...] = (buffer, arguments, results)) -> None:
        call()

    return run
