"""Task of a planner in `parking-v0`: the goal, the walls, the parked vehicles, and braking."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.errors import ConfigError
from dynamics.learned.tasks import parking_state as parking
from dynamics.learned.tasks.parking_state import Parking
from dynamics.vehicle.actuators import Actuators
from mpc.sampling.cem import PlannerSettings
from mpc.sampling.plan import Fallback
from mpc.tasks.costs import Sum, TerminalWeight, TimeCost
from mpc.tasks.parking_costs import GoalCost, ObstacleCost, StopCost, SuccessMask, WallCost

__all__ = ["PROFILES", "ParkingTask", "ParkingWeights", "brake", "parking_settings"]


PROFILES = {"quality": 4, "fast": 2, "plain": 4, "icem": 4, "mppi": 4}
"""Number of iterations in the planner's named profiles."""


@dataclass(frozen=True, slots=True)
class ParkingWeights:
    """Weights of the costs of parking; costs in time are per second.

    Attributes
    ----------
    goal : weight of the distance to the goal.
    time : cost of each second until success.
    terminal : time for which the last state counts [s].
    stop : cost of each m/s beyond `speed` on arrival.
    speed : arrival speed without cost [m/s].
    threshold : distance that counts as success in a plan.
    stop_threshold : distance at which `stop` applies.
    heading : factor on the weight of the heading in the distance to the goal.
    wall, obstacle : cost of each metre nearer than the margin, for each evaluated state.
    wall_margin, obstacle_margin : the margins [m].
    """

    goal: float = 1.0
    time: float = 0.0
    terminal: float = 5.0
    stop: float = 1.0
    speed: float = 0.6
    threshold: float = 0.118
    stop_threshold: float = 0.122
    heading: float = 4.0
    wall: float = 1.0
    wall_margin: float = 0.5
    obstacle: float = 1.0
    obstacle_margin: float = 0.5


def parking_settings(profile: str = "quality", **changes: Any) -> PlannerSettings:
    """Settings of the search for a path into a spot: 8 blocks of 0.8 s, the first two at high resolution, 128 samples.

    Parameters
    ----------
    profile : one of `PROFILES`: "quality" is 4 restarts of iCEM in 4 iterations, "fast" in 2. For comparison "plain" is
        the Cross-Entropy Method without any addition, "icem" is one restart, "mppi" is for `mpc.sampling.mppi.MPPI`.
    changes : other values of `PlannerSettings`.

    Raises
    ------
    ConfigError
        If there is no such profile, or a value is out of range.
    """
    if profile not in PROFILES:
        raise ConfigError(f"unknown profile {profile!r}; have {', '.join(PROFILES)}")
    searches = {"plain": _PLAIN, "icem": _SINGLE, "mppi": PlannerSettings.mppi()}
    settings = searches.get(profile, PlannerSettings.multistart())
    return settings.replace(
        **{"blocks": 8, "hold": 4, "look": 1, "fine": 2, "iterations": PROFILES[profile], **changes}
    )


_PLAIN, _SINGLE = PlannerSettings(samples=128), PlannerSettings.icem(samples=128, elites=20)


class ParkingTask:
    """Reads goal-conditioned observations, and obstacles from the simulator, and defines the cost.

    Parameters
    ----------
    env : a parking environment, wrapped or not, or a VecEnv of them in this process.
    weights : weights of the costs.

    Raises
    ------
    ConfigError
        If it is not parking with one vehicle and continuous actions, or its environments are in other processes.
    """

    def __init__(self, env: Any, weights: ParkingWeights | None = None) -> None:
        self.weights = weights if weights is not None else ParkingWeights()
        self.bases = _bases(env)
        for base in self.bases:
            kind = type(base.action_type).__name__
            if kind != "ContinuousAction" or "success_goal_reward" not in base.config:
                raise ConfigError(
                    f"ParkingTask needs parking-v0 with ContinuousAction; this is {type(base).__name__} with {kind}"
                )
            if not np.array_equal(base.config["observation"].get("scales", ()), parking.SCALES):
                raise ConfigError(
                    f"ParkingTask reads KinematicsGoal observations with scales {parking.SCALES.tolist()}"
                )
        self._roads: list[Any] = [None] * len(self.bases)
        self._boxes: list[Any] = [np.empty((0, 5))] * len(self.bases)

    def read(self, observation: Any) -> tuple[Any, Any, bool]:
        """States (E, 6), goals (E, 6), both float32, and whether there was a single observation."""
        states, goals = parking.state(observation), parking.goal(observation)
        single = states.ndim == 1
        return np.atleast_2d(states).astype(np.float32), np.atleast_2d(goals).astype(np.float32), single

    def cost(self, observation: Any, started: Any) -> Sum:
        """Cost of the path to the goal, with walls and parked vehicles."""
        goal, w = np.atleast_2d(parking.goal(observation)).astype(np.float32), self.weights
        if len(goal) != len(self.bases):
            raise ConfigError(f"{len(goal)} observations for {len(self.bases)} environments; a batch needs one each")
        second = 1.0 / float(self.bases[0].config["policy_frequency"])
        total = (w.goal * second) * GoalCost(goal, w.heading) + w.stop * StopCost(goal, w.speed, w.stop_threshold)
        if w.time:
            total += (w.time * second) * TimeCost()
        if self.bases[0].config["add_walls"]:
            total += w.wall * WallCost(margin=w.wall_margin)
        boxes = self._obstacles()
        if boxes.shape[1]:
            total += w.obstacle * ObstacleCost(boxes, w.obstacle_margin)
        return total + SuccessMask(goal, w.threshold) + TerminalWeight(w.terminal / second)

    def _obstacles(self) -> Any:
        """Other vehicles, (E, m, 5), with NaN rows for environments with fewer than others."""
        for i, base in enumerate(self.bases):
            if base.road is not self._roads[i]:
                others = [v for v in base.road.vehicles if v is not base.vehicle]
                rows = [(*v.position, v.heading, v.LENGTH / 2, v.WIDTH / 2) for v in others]
                self._roads[i], self._boxes[i] = base.road, np.array(rows, float).reshape(-1, 5)
        most = max(len(b) for b in self._boxes)
        pad = [np.pad(b, ((0, most - len(b)), (0, 0)), constant_values=np.nan) for b in self._boxes]
        return np.stack(pad)


def brake(env: Any) -> Fallback:
    """Actions that stop a parking vehicle as fast as its actuators can, with straight steering; zero at a standstill.

    Parameters
    ----------
    env : environment with the throttle and the decision period of the actions.
    """
    base = getattr(env, "unwrapped", env)
    actuators, period = Actuators.of(base.action_type), 1.0 / float(base.config["policy_frequency"])

    def act(states: Any) -> Any:
        speed = states[:, Parking.VX] * states[:, Parking.COS] + states[:, Parking.VY] * states[:, Parking.SIN]
        inputs = np.zeros((len(states), 2))
        inputs[:, 0] = np.clip(-np.nan_to_num(speed, posinf=0, neginf=0) / period, *actuators.acceleration)
        return actuators.normalised(inputs)

    return act


def _bases(env: Any) -> list[Any]:
    """The unwrapped highway-env environments inside `env`."""
    if not hasattr(env, "num_envs"):
        return [env.unwrapped]
    inner = getattr(env, "envs", None)
    if inner is None:
        raise ConfigError(
            f"{type(env).__name__} keeps its environments in other processes, where obstacles cannot be read; "
            "use a DummyVecEnv, or one policy in each process"
        )
    return [e.unwrapped for e in inner]
