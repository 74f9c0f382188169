"""Initial inputs of a descent: the last plan shifted in time, or the proposal and then full braking."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np
import numpy.typing as npt

from dynamics.state import FloatArray
from dynamics.vehicle.bicycle import LENGTH
from mpc.filter.problem import FilterProblem, FilterSettings
from mpc.filter.program.road_step import feed_forward, stage_expression, without_reverse

__all__ = ["brake_guess", "braking_function", "in_force", "shifted"]

_TURN = 0.1
"""Greatest turn relative to the road in a stage of a braking guess [rad]."""
_STRAIGHTEN = 0.5
"""Share of the heading that a braking guess corrects in each stage."""


def shifted(plan: FloatArray, frames: int, settings: FilterSettings) -> FloatArray:
    """The plan's inputs (N, 2) `frames` later: those in force at the start of each stage; the last one is repeated."""
    return np.asarray(plan[in_force(frames, settings)])


def in_force(frames: int, settings: FilterSettings) -> npt.NDArray[np.intp]:
    """Index of the former stage in force at the start of each stage of a plan that begins `frames` later, (N,)."""
    ends = np.array(settings.ends)
    begins = ends - settings.frames + frames
    return np.minimum(np.searchsorted(ends, begins, side="right"), settings.stages - 1)


def brake_guess(problem: FilterProblem, settings: FilterSettings) -> FloatArray:
    """The proposal's acceleration for one stage, then full braking; steering along the road, (N, 2).

    Programs end braking at a standstill, in the stage of each rollout in which the car comes to rest.
    """
    n = settings.stages
    curvature = np.zeros(n) if problem.curvature is None else problem.curvature
    first = np.array([settings.acceleration[0], 0.0]) if problem.proposal is None else problem.proposal
    out = braking_function(settings)(problem.state, first, curvature)
    return np.asarray(out.full().T)


@lru_cache(maxsize=16)
def braking_function(settings: FilterSettings) -> ca.Function:
    """Compiled function from state (4,), first inputs (2,) and curvatures (N,) to the braking guess (2, N)."""
    n = settings.stages
    x0, first, curvature = ca.SX.sym("x", 4), ca.SX.sym("first", 2), ca.SX.sym("k", n)
    x, inputs = x0, []
    for k, frames in enumerate(settings.frames):
        psi, v, duration = x[2], x[3], settings.dt * frames
        turn = ca.fmax(ca.fabs(v) * duration / (LENGTH / 2), 0.5)
        most = _TURN / turn
        wanted = ca.atan(2 * ca.tan(ca.asin(ca.fmax(ca.fmin(-_STRAIGHTEN * psi / turn, most), -most))))
        ideal = feed_forward(curvature[k], x[1])
        if k == 0:
            angle = ca.atan(2 * ca.tan(ca.asin(ca.fmin(most, 0.5))))
            steer = ca.fmax(ca.fmin(first[1], ideal + angle), ideal - angle)
        else:
            steer = ideal + wanted
        steer = ca.fmax(ca.fmin(steer, settings.steering), -settings.steering)
        u = ca.vertcat(first[0] if k == 0 else settings.acceleration[0], steer)
        inputs.append(u)
        x = stage_expression(x, without_reverse(u, v, duration), curvature[k], settings.dt, frames)
    return ca.Function("braking", [x0, first, curvature], [ca.horzcat(*inputs)])
