r"""Task of a planner over meta-actions on a straight highway: rewards for speed and the right lane, cost of contact.

Notation
--------
States are those of `dynamics.learned.tasks.traffic_model`. Positions between two evaluated states are interpolated
linearly. A plan that comes nearer to a vehicle than the margins at any of `_PARTS` times in between costs `contact`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.errors import ConfigError, DataError
from dynamics.learned.tasks.traffic_model import EGO, VEHICLE
from dynamics.vehicle.bicycle import LENGTH, WIDTH
from mpc.sampling.plan import Trajectories
from mpc.tasks.costs import Sum, Term

__all__ = ["ChangeCost", "ContactCost", "HighwayTask", "HighwayWeights", "LaneCost", "PaceCost"]

_PARTS = 4


@dataclass(frozen=True, slots=True)
class ContactCost(Term):
    """Cost of coming too near to another vehicle, and a smaller one of a gap that closes too fast.

    The cost is `entry` when the ego's centre enters the area around another vehicle's. It rises to 1 at contact of the
    bodies, and stays 1 from then on. So among plans that all come too near, the one with the greatest distance is the
    cheapest. Among plans that all crash, the one with the latest crash is the cheapest, and driving through a vehicle
    never pays.

    Attributes
    ----------
    length, width : half extents of the area around another vehicle's centre that the ego's centre must avoid [m]; more
        than a vehicle's.
    entry : cost of entering the area.
    headway : time of the closing speed that the gap to a vehicle ahead should cover [s].
    soft : cost without any gap.
    """

    length: float = LENGTH + 2.0
    width: float = WIDTH + 0.8
    entry: float = 0.3
    headway: float = 2.0
    soft: float = 0.3

    def stages(self, trajectories: Trajectories) -> Any:
        """Costs, (E, S, T)."""
        t = trajectories
        e, s, steps = t.states.shape[:3]
        others = t.states[..., EGO:].reshape(e, s, steps, -1, VEHICLE)
        first = np.broadcast_to(
            t.start[:, None, None, EGO:].reshape(e, 1, 1, -1, VEHICLE), (e, s, 1, *others.shape[3:])
        )
        before = np.concatenate([first, others[:, :, :-1]], axis=2)
        share = (np.arange(1, _PARTS + 1) / _PARTS).astype(t.states.dtype)
        dx, dy = (before[..., i, None] + (others[..., i] - before[..., i])[..., None] * share for i in (1, 2))
        # Depth inside the area relative to its margin around the bodies, along and across; the lesser counts.
        inside = np.minimum(
            (self.length - np.abs(dx)) / (self.length - LENGTH), (self.width - np.abs(dy)) / (self.width - WIDTH)
        )
        near = (self.entry + (1 - self.entry) * np.clip(inside, 0, 1)) * ((inside > 0) & (others[..., :1] > 0))
        worst = near.max(axis=(-1, -2))
        crashed = np.maximum.accumulate(worst >= 1, axis=-1)
        gap, side, closing = others[..., 1] - self.length, np.abs(others[..., 2]), -others[..., 3]
        ahead = (others[..., 0] > 0) & (others[..., 1] > 0) & (side < self.width)
        need = self.headway * np.maximum(closing, 0) + 3.0
        short = np.clip(1 - gap / need, 0, 1) * ahead
        return np.where(crashed, 1.0, worst) + self.soft * short.max(axis=-1)


@dataclass(frozen=True, slots=True)
class PaceCost(Term):
    """Shortfall of the speed below the best paid one, from 0 at `high` to 1 at `low` [m/s], for each decision."""

    low: float
    high: float

    def stages(self, trajectories: Trajectories) -> Any:
        """Costs, (E, S, T)."""
        pace = (self.high - trajectories.states[..., 2]) / (self.high - self.low)
        return np.clip(pace, 0, 1) * trajectories.spans


@dataclass(frozen=True, slots=True)
class LaneCost(Term):
    """Distance from the rightmost lane, from 0 to 1 in the leftmost, for each decision; centre lines in y [m]."""

    right: float
    left: float = 0.0

    def stages(self, trajectories: Trajectories) -> Any:
        """Costs, (E, S, T)."""
        y = trajectories.states[..., 0]
        return np.clip((self.right - y) / (self.right - self.left), 0, 1) * trajectories.spans


@dataclass(frozen=True, slots=True)
class HighwayWeights:
    """Weights of the costs, for each decision.

    Attributes
    ----------
    pace, lane : weights of the speed and of the lane, as in the environment's reward.
    change : weight of a lane change.
    contact : weight of coming too near.
    length, width, headway : parameters of `ContactCost`.
    """

    pace: float = 0.4
    lane: float = 0.1
    change: float = 0.05
    contact: float = 20.0
    length: float = LENGTH + 2.0
    width: float = WIDTH + 0.8
    headway: float = 2.0


@dataclass(frozen=True, slots=True)
class ChangeCost(Term):
    """Cost of 1 for each decision to change lanes; `actions` are the indices of those meta-actions."""

    actions: tuple[int, ...]

    def stages(self, trajectories: Trajectories) -> Any:
        """Costs, (E, S, T)."""
        return np.isin(trajectories.actions[..., 0], self.actions).astype(trajectories.states.dtype)


class HighwayTask:
    """Reads Kinematics observations of a straight highway, and defines the cost.

    Parameters
    ----------
    env : the environment, wrapped or not, after a reset.
    weights : weights of the costs.

    Raises
    ------
    ConfigError
        If its observation is not highway-env's default Kinematics, or its actions are no meta-actions.
    """

    def __init__(self, env: Any, weights: HighwayWeights | None = None) -> None:
        base = env.unwrapped
        kind = base.observation_type
        if type(kind).__name__ != "KinematicObservation" or kind.features != ["presence", "x", "y", "vx", "vy"]:
            raise ConfigError("HighwayTask reads Kinematics observations with presence, x, y, vx, vy")
        if type(base.action_type).__name__ != "DiscreteMetaAction" or kind.absolute or not kind.normalize:
            raise ConfigError("HighwayTask needs DiscreteMetaAction, and observations normalised and relative")
        self.weights = weights if weights is not None else HighwayWeights()
        self.lanes = int(base.config["lanes_count"])
        # `KinematicObservation.normalize_obs` of highway-env 1.12: 5 and 2 times the greatest speed, 4 m per lane.
        self.scales = np.array([1.0, 200.0, 4.0 * self.lanes, 80.0, 80.0])
        self.speeds = tuple(float(v) for v in base.config["reward_speed_range"])
        indexes = base.action_type.actions_indexes
        self.actions, self.vehicles = len(indexes), int(kind.vehicles_count) - 1
        self.slower = int(indexes["SLOWER"])
        self.changes = tuple(int(indexes[name]) for name in ("LANE_LEFT", "LANE_RIGHT") if name in indexes)

    def read(self, observation: Any) -> tuple[Any, Any, bool]:
        """States (E, 3 + 5 K), episode marks (E, 1), which are all equal, and whether there was one observation."""
        array = np.asarray(observation, float)
        single = array.ndim == 2
        array = array[None] if single else array
        if array.ndim != 3 or array.shape[2] != 5:
            raise DataError(f"a Kinematics observation has shape (vehicles, 5), got {np.shape(observation)}")
        rows = array * self.scales
        states = np.concatenate([rows[:, 0, [2, 4, 3]], rows[:, 1:].reshape(len(rows), -1)], axis=1)
        return states.astype(np.float32), np.zeros((len(rows), 1)), single

    def cost(self, observation: Any, started: Any) -> Sum:
        """Weighted sum of pace, lane, lane changes and contact."""
        w = self.weights
        return (
            w.pace * PaceCost(*self.speeds)
            + w.lane * LaneCost(right=4.0 * (self.lanes - 1))
            + w.change * ChangeCost(self.changes)
            + w.contact * ContactCost(w.length, w.width, headway=w.headway)
        )
