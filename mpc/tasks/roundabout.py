r"""Task of a planner over meta-actions in a roundabout: reward for speed, cost of contact.

Notation
--------
States are those of `dynamics.learned.tasks.roundabout_model`: every other vehicle has two rows, one that stays on at
the next exit and one that leaves. Between two evaluated states a vehicle moves along the cubic through both positions
with both velocities (Hermite); at 16 m/s and a radius of 22 m that is within 2 cm of the circle after 1 s. A vehicle
is a rectangle along its direction. Of the possible separating axes of two rectangles only those of the other vehicle
are tested, so that a pair that counts as clear is clear.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.errors import ConfigError, DataError
from dynamics.learned.tasks.roundabout_model import EGO, ROW
from dynamics.vehicle.bicycle import LENGTH, WIDTH
from mpc.sampling.categorical import CategoricalSettings
from mpc.sampling.plan import Trajectories
from mpc.tasks.costs import Sum, Term
from mpc.tasks.highway import ChangeCost

__all__ = ["ClearanceCost", "RoundaboutTask", "RoundaboutWeights", "TargetCost", "roundabout_settings"]

_PARTS = 6
_STOPPED = 1e-6
"""Speed below which an observation has no direction [m/s]."""


@dataclass(frozen=True, slots=True)
class TargetCost(Term):
    """Shortfall of the target speed below the highest one, from 0 to 1, for each decision.

    The environment's reward is for the index of the target speed, not for the speed. FASTER and SLOWER set the target
    speed next to the one nearest to the ego's speed. Source: `RoundaboutEnv._rewards` and `MDPVehicle.act` of
    highway-env 1.12.

    Attributes
    ----------
    speeds : target speeds [m/s], evenly spaced, ascending.
    faster, slower : indices of those meta-actions.
    """

    speeds: tuple[float, ...]
    faster: int
    slower: int

    def stages(self, trajectories: Trajectories) -> Any:
        """Costs, (E, S, T)."""
        t = trajectories
        first = np.broadcast_to(t.start[:, None, None], (*t.states.shape[:2], 1, t.states.shape[-1]))
        now = np.concatenate([first, t.states[:, :, :-1]], axis=2)
        low, high, top = self.speeds[0], self.speeds[-1], len(self.speeds) - 1
        index = np.round((np.hypot(now[..., 2], now[..., 3]) - low) / (high - low) * top)
        number = t.actions[..., 0]
        index = np.clip(index + (number == self.faster) - (number == self.slower), 0, top)
        return (top - index) / top * t.spans


@dataclass(frozen=True, slots=True)
class ClearanceCost(Term):
    """Cost of coming too near to another vehicle: `entry` at the edge of the margins, 1 at contact and from then on.

    Attributes
    ----------
    along, across : margins along and across the other vehicle [m].
    growth : growth of both margins for each second ahead [m/s].
    entry : cost of entering the margins.
    dt : duration of a decision [s].
    """

    along: float = 2.0
    across: float = 0.8
    growth: float = 0.0
    entry: float = 0.3
    dt: float = 1.0

    def stages(self, trajectories: Trajectories) -> Any:
        """Costs, (E, S, T)."""
        t = trajectories
        e, s, steps = t.states.shape[:3]
        first = np.broadcast_to(t.start[:, None, None], (e, s, 1, t.start.shape[-1]))
        states = np.concatenate([first, t.states], axis=2)
        seconds = self.dt * t.spans
        ego, ego_way = _between(states[..., :EGO], seconds)
        rows = states[..., EGO:].reshape(e, s, steps + 1, -1, ROW)
        other, way = _between(np.moveaxis(rows[..., 1:7], 3, 2), seconds)
        dx, dy = (other[..., i] - ego[:, :, None, ..., i] for i in (0, 1))
        cos, sin = way[..., 0], way[..., 1]
        turn_cos = np.abs(ego_way[:, :, None, ..., 0] * cos + ego_way[:, :, None, ..., 1] * sin)
        turn_sin = np.abs(ego_way[:, :, None, ..., 0] * sin - ego_way[:, :, None, ..., 1] * cos)
        # Gaps between the bodies along and across the other one, relative to the margins there; the greater counts.
        half = 0.5 * LENGTH * turn_cos + 0.5 * WIDTH * turn_sin + 0.5 * LENGTH
        side = 0.5 * LENGTH * turn_sin + 0.5 * WIDTH * turn_cos + 0.5 * WIDTH
        ahead = self.growth * np.cumsum(seconds)[:, None]
        gap = np.maximum(
            (np.abs(cos * dx + sin * dy) - half) / (self.along + ahead),
            (np.abs(cos * dy - sin * dx) - side) / (self.across + ahead),
        )
        there = rows[:, :, 1:, :, 0].swapaxes(2, 3)[..., None] > 0
        cost = (self.entry + (1 - self.entry) * np.clip(1 - gap, 0, 1)) * ((gap < 1) & there)
        worst = cost.max(axis=(2, 4), initial=0.0)
        return np.where(np.maximum.accumulate(worst >= 1, axis=-1), 1.0, worst)


def _between(states: Any, seconds: Any) -> tuple[Any, Any]:
    """Positions and directions at `_PARTS` times up to each state but the first.

    The shapes are (..., T + 1, 6) of the states and (..., T, parts, 2) of the results.
    """
    a, b = states[..., :-1, None, :], states[..., 1:, None, :]
    w = (np.arange(1, _PARTS + 1) / _PARTS).astype(states.dtype)[:, None]
    h = seconds[:, None, None].astype(states.dtype)
    place = (
        (1 + 2 * w) * (1 - w) ** 2 * a[..., :2]
        + w * (1 - w) ** 2 * h * a[..., 2:4]
        + w**2 * (3 - 2 * w) * b[..., :2]
        + w**2 * (w - 1) * h * b[..., 2:4]
    )
    way = (1 - w) * a[..., 4:] + w * b[..., 4:]
    return place, way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-6)


@dataclass(frozen=True, slots=True)
class RoundaboutWeights:
    """Weights of the costs, for each decision.

    Attributes
    ----------
    pace : weight of the target speed.
    change : weight of a decision to change lanes.
    contact : weight of coming too near.
    along, across, growth, entry : parameters of `ClearanceCost`.
    """

    pace: float = 0.2
    change: float = 0.05
    contact: float = 10.0
    along: float = 1.5
    across: float = 0.6
    growth: float = 0.2
    entry: float = 0.3


def roundabout_settings() -> CategoricalSettings:
    """Settings of the search in a roundabout: 5 decisions ahead."""
    return CategoricalSettings(blocks=5, iterations=4, samples=128, elites=16)


class RoundaboutTask:
    """Reads Kinematics observations of highway-env's roundabout, and defines the cost.

    Parameters
    ----------
    env : the environment, wrapped or not, after a reset. The road map, the ego's own route and the configuration are
        read from it; the traffic is read from observations only.
    weights : weights of the costs.

    Raises
    ------
    ConfigError
        If it is not the roundabout, its observation is not its default absolute Kinematics, or its actions are no
        meta-actions.
    """

    def __init__(self, env: Any, weights: RoundaboutWeights | None = None) -> None:
        base = env.unwrapped
        kind = base.observation_type
        if type(base).__name__ != "RoundaboutEnv":
            raise ConfigError(f"RoundaboutTask reads highway-env's RoundaboutEnv, got {type(base).__name__}")
        if type(kind).__name__ != "KinematicObservation" or kind.features != ["presence", "x", "y", "vx", "vy"]:
            raise ConfigError("RoundaboutTask reads Kinematics observations with presence, x, y, vx, vy")
        if type(base.action_type).__name__ != "DiscreteMetaAction" or not (kind.absolute and kind.normalize):
            raise ConfigError("RoundaboutTask needs DiscreteMetaAction, and observations normalised and absolute")
        ranges = kind.features_range or {}
        if set(ranges) != {"x", "y", "vx", "vy"} or any(low != -high for low, high in ranges.values()):
            raise ConfigError(f"RoundaboutTask needs features_range of x, y, vx, vy around 0, got {ranges}")
        self.weights = weights if weights is not None else RoundaboutWeights()
        self.scales = np.array([1.0, *(float(ranges[name][1]) for name in ("x", "y", "vx", "vy"))])
        indexes = base.action_type.actions_indexes
        self.actions, self.vehicles = len(indexes), int(kind.vehicles_count) - 1
        self.rows = 2 * self.vehicles
        self.faster, self.slower = int(indexes["FASTER"]), int(indexes["SLOWER"])
        self.changes = tuple(int(indexes[name]) for name in ("LANE_LEFT", "LANE_RIGHT") if name in indexes)
        self.speeds = tuple(float(v) for v in base.action_type.target_speeds)
        self.dt = 1.0 / float(base.config["policy_frequency"])
        self.exit_arm = "eswn".index(str(base.vehicle.route[-1][1])[0])

    def read(self, observation: Any) -> tuple[Any, Any, bool]:
        """States (E, 6 + 8 * 2 V), episode marks (E, 1), which are all equal, and whether there was one observation."""
        array = np.asarray(observation, float)
        single = array.ndim == 2
        array = array[None] if single else array
        if array.ndim != 3 or array.shape[1:] != (self.vehicles + 1, 5):
            raise DataError(f"a Kinematics observation has shape ({self.vehicles + 1}, 5), got {np.shape(observation)}")
        rows = array * self.scales
        speed = np.linalg.norm(rows[..., 3:], axis=-1, keepdims=True)
        # A vehicle without speed is assumed to point to the centre.
        inward = -rows[..., 1:3] / np.maximum(np.linalg.norm(rows[..., 1:3], axis=-1, keepdims=True), 1e-6)
        way = np.where(speed > _STOPPED, rows[..., 3:] / np.maximum(speed, _STOPPED), inward)
        seen = np.concatenate([rows, way], axis=-1)
        both = np.repeat(seen[:, 1:], 2, axis=1)
        leaves = np.broadcast_to(np.tile([0.0, 1.0], self.vehicles)[:, None], (*both.shape[:2], 1))
        others = np.concatenate([both, leaves], axis=-1).reshape(len(rows), -1)
        states = np.concatenate([seen[:, 0, 1:], others], axis=1)
        return states.astype(np.float32), np.zeros((len(rows), 1)), single

    def cost(self, observation: Any, started: Any) -> Sum:
        """Weighted sum of target speed, lane changes and contact."""
        w = self.weights
        return (
            w.pace * TargetCost(self.speeds, self.faster, self.slower)
            + w.change * ChangeCost(self.changes)
            + w.contact * ClearanceCost(w.along, w.across, w.growth, w.entry, self.dt)
        )
