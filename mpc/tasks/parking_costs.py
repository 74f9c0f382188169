r"""Costs of parking, on states (x, y [m], vx, vy [m/s], cos psi, sin psi) of `dynamics.learned.tasks.parking_state`.

Notation
--------
The distance to the goal g is highway-env's, d = (w . |(z - g) / SCALES|)^(1/2) with the weights w of the reward.
Parking has succeeded if d < SUCCESS. Source: `ParkingEnv.compute_reward` of highway-env 1.12.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dynamics.learned.tasks.parking_state import SCALES, Parking
from dynamics.vehicle.bicycle import LENGTH, WIDTH
from mpc.sampling.plan import Trajectories
from mpc.tasks.costs import Factor, Term

__all__ = ["SUCCESS", "WEIGHTS", "GoalCost", "ObstacleCost", "StopCost", "SuccessMask", "WallCost", "goal_distance"]

WEIGHTS = np.array([1.0, 0.3, 0.0, 0.0, 0.02, 0.02])
"""Weights of the reward on the observation's entries (`reward_weights`)."""
SUCCESS = 0.12
"""Distance to the goal below which parking has succeeded (`success_goal_reward`)."""


def goal_distance(states: Any, goal: Any) -> Any:
    """highway-env's distance to the goal, from states (E, ..., 6) and a goal (E, 6) or (6,) to (E, ...)."""
    return np.sqrt(sum(_squares(states, goal)))


def _squares(states: Any, goal: Any) -> tuple[Any, Any]:
    """Parts of the squared distance from position and from heading, (E, ...) each."""
    goal = np.asarray(goal, states.dtype)
    goal = goal.reshape(*goal.shape[:-1], *(1,) * (states.ndim - 2 if goal.ndim > 1 else 0), goal.shape[-1])
    x, y, cos, sin = (
        states.dtype.type(WEIGHTS[i] / SCALES[i]) * np.abs(states[..., i] - goal[..., i])
        for i in (Parking.X, Parking.Y, Parking.COS, Parking.SIN)
    )
    return x + y, cos + sin


def _parts(trajectories: Trajectories, goal: Any) -> tuple[Any, Any]:
    """`_squares` of evaluated states, computed once for all parts of a cost with the same goal."""
    key = ("goal", id(goal))
    if key not in trajectories.memo:
        # The reference to the goal keeps its id unique.
        trajectories.memo[key] = (_squares(trajectories.states, goal), goal)
    found: tuple[Any, Any] = trajectories.memo[key][0]
    return found


@dataclass(frozen=True, slots=True, eq=False)
class GoalCost(Term):
    """Distance to the goal, (E, 6) or (6,), for each decision; `heading` is a factor on the weight of the heading."""

    goal: Any
    heading: float = 1.0

    def stages(self, trajectories: Trajectories) -> Any:
        """Costs, (E, S, T)."""
        position, heading = _parts(trajectories, self.goal)
        return np.sqrt(position + self.heading * heading) * trajectories.spans


@dataclass(frozen=True, slots=True, eq=False)
class SuccessMask(Factor):
    """No cost after the first evaluated state with success.

    Attributes
    ----------
    goal : (E, 6) or (6,).
    threshold : distance that counts as success; less than `SUCCESS` for an inaccurate model.
    """

    goal: Any
    threshold: float = SUCCESS

    def weights(self, trajectories: Trajectories) -> Any:
        """Weights, (E, S, T), 1 up to and including the first success."""
        position, heading = _parts(trajectories, self.goal)
        over = np.logical_or.accumulate(position + heading < self.threshold**2, axis=2)
        out = np.ones(over.shape, trajectories.states.dtype)
        out[..., 1:] -= over[..., :-1]
        return out


@dataclass(frozen=True, slots=True, eq=False)
class StopCost(Term):
    """Speed beyond `limit` [m/s] in states with success; with `SuccessMask`, the speed on arrival."""

    goal: Any
    limit: float = 0.6
    threshold: float = SUCCESS

    def stages(self, trajectories: Trajectories) -> Any:
        """Costs, (E, S, T) [m/s]."""
        states = trajectories.states
        position, heading = _parts(trajectories, self.goal)
        speed = np.hypot(states[..., Parking.VX], states[..., Parking.VY])
        return np.maximum(speed - self.limit, 0) * (position + heading < self.threshold**2)


@dataclass(frozen=True, slots=True, eq=False)
class WallCost(Term):
    """Length by which the footprint is nearer than the margin to the walls of a rectangular lot [m], plus a step.

    Attributes
    ----------
    half : half extents of the free area around the origin, (x, y) [m].
    margin : required clearance [m].
    step : additional cost of any violation.
    """

    half: tuple[float, float] = (34.5, 20.5)
    margin: float = 0.5
    step: float = 1.0

    def stages(self, trajectories: Trajectories) -> Any:
        """Costs, (E, S, T)."""
        states = trajectories.states
        cos, sin = np.abs(states[..., Parking.COS]), np.abs(states[..., Parking.SIN])
        along = np.abs(states[..., Parking.X]) + 0.5 * (LENGTH * cos + WIDTH * sin) - (self.half[0] - self.margin)
        across = np.abs(states[..., Parking.Y]) + 0.5 * (LENGTH * sin + WIDTH * cos) - (self.half[1] - self.margin)
        depth = np.maximum(along, across)
        return np.maximum(depth, 0) + self.step * (depth > 0)


@dataclass(frozen=True, slots=True, eq=False)
class ObstacleCost(Term):
    """Length by which the footprint is nearer than the margin to rectangles at rest [m], plus a step.

    The footprint is covered by discs, so clearance is underestimated by at most their excess (0.18 m sideways).

    Attributes
    ----------
    boxes : (E, m, 5) or (m, 5): x, y [m], heading [rad], half length, half width [m]; NaN rows are ignored.
    margin : required clearance [m].
    step : additional cost of any violation.
    discs : number of discs that cover the footprint.
    """

    boxes: Any
    margin: float = 0.5
    step: float = 1.0
    discs: int = 4
    _ready: list[Any] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        boxes = np.asarray(self.boxes, np.float32).reshape(-1, *np.shape(self.boxes)[-2:])
        boxes = np.where(np.isnan(boxes).any(axis=-1, keepdims=True), np.array([1e6, 1e6, 0, 1, 1], np.float32), boxes)
        x, y, heading, half_length, half_width = (boxes[..., i] for i in range(5))
        self._ready.extend((x, y, np.cos(heading), np.sin(heading), half_length, half_width))

    def stages(self, trajectories: Trajectories) -> Any:
        """Costs, (E, S, T)."""
        states = trajectories.states
        if not self._ready[0].shape[-1]:
            return np.zeros(states.shape[:3], states.dtype)
        part = LENGTH / self.discs
        offsets = np.asarray((np.arange(self.discs) - (self.discs - 1) / 2) * part, states.dtype)
        radius = float(np.hypot(part / 2, WIDTH / 2))
        x = states[..., Parking.X, None] + states[..., Parking.COS, None] * offsets
        y = states[..., Parking.Y, None] + states[..., Parking.SIN, None] * offsets
        bx, by, cos, sin, half_length, half_width = (v[:, None, None, None] for v in self._ready)
        dx, dy = x[..., None] - bx, y[..., None] - by
        along = np.maximum(np.abs(dx * cos + dy * sin) - half_length, 0)
        across = np.maximum(np.abs(dy * cos - dx * sin) - half_width, 0)
        near = np.sqrt(np.min(along * along + across * across, axis=(-1, -2)))
        depth = radius + self.margin - near
        return np.maximum(depth, 0) + self.step * (depth > 0)
