"""`CompiledHighwayEnv`: one compiled highway as a Gymnasium environment, which a supervision may control frame by
frame."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.action import action_factory
from highway_env.envs.common.observation import ObservationType, observation_factory
from highway_env.road.road import RoadNetwork
from highway_env.vehicle.kinematics import Vehicle

from dynamics.highway_simulator.layout import ACCELERATION, LANE, SPEED, STEERING, TARGET, TARGET_SPEED
from dynamics.highway_simulator.scenario import REWARDS
from dynamics.highway_simulator.simulator import Simulator
from dynamics.scenes.registration import spec_of
from dynamics.state import FloatArray

__all__ = ["CompiledHighwayEnv"]

_COLUMNS = 7


class CompiledHighwayEnv(gym.Env[Any, Any]):
    """`highway-v0` or `highway-fast-v0`, compiled, equal to highway-env to the last bit. It does not render.

    It has the part of highway-env's interface that a shield needs. This is the road map, the configuration, the ego and
    its `act`, the scene as rows, and `observation_type`, which observes at any frame.

    Parameters
    ----------
    env_id, config : as of `Simulator`.

    Attributes
    ----------
    simulator : the state, and the methods that step it. config : the whole configuration.
    frames : the bodies in each frame since the reset, (m, 7): x, y [m], heading [rad], speed [m/s], length, width [m],
        crashed. off_road : whether the ego was off the road in each.

    Examples
    --------
    >>> env = CompiledHighwayEnv("highway-fast-v0")
    >>> obs, info = env.reset(seed=0)
    >>> obs, reward, terminated, truncated, info = env.step(3)
    >>> len(env.frames)
    6
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012
    PERCEPTION_DISTANCE = AbstractEnv.PERCEPTION_DISTANCE

    def __init__(self, env_id: str = "highway-fast-v0", config: Mapping[str, Any] | None = None) -> None:
        self.simulator = Simulator(env_id, 1, config)
        scenario = self.simulator.scenario
        self.config = dict(scenario.config)
        self.observation_space, self.action_space = scenario.observation_space, scenario.action_space
        self.render_mode, self.spec = None, spec_of(env_id)
        self.road: Any = None
        self.controlled_vehicles: list[_Ego] = [_Ego(self)]
        self.action_type = action_factory(self, self.config["action"])
        self.observation_type: ObservationType = observation_factory(self, self.config["observation"])
        self.observation_type.observe = self._observe
        self._network = RoadNetwork.straight_road_network(self.config["lanes_count"], speed_limit=30)
        self._frames_per_decision = scenario.rules.numbers[0]
        self.frames: list[FloatArray] = []
        self.off_road: list[bool] = []
        self.steps, self.time = 0, 0.0

    @property
    def vehicle(self) -> _Ego:
        """The ego."""
        return self.controlled_vehicles[0]

    @property
    def rows(self) -> FloatArray:
        """The present bodies, the ego first, (m, 7); see `frames`."""
        return self.frames[-1]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode. A seed gives the same traffic as in highway-env."""
        super().reset(seed=seed)
        observations = self.simulator.reset(None if seed is None else [seed])
        self.road = SimpleNamespace(network=self._network)
        self.controlled_vehicles = [_Ego(self)]
        self.frames, self.off_road, self.steps, self.time = [], [], 0, 0.0
        self._keep(self.simulator.write_rows)
        return observations[0].copy(), {"speed": self.vehicle.speed, "crashed": False}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One decision."""
        ego = self.vehicle
        self.time += 1 / self.config["policy_frequency"]
        ego.act(action)
        for _ in range(self._frames_per_decision):
            ego.act()
            throttle, wheel = ego.override
            self._keep(lambda rows: self.simulator.frame(rows, throttle, wheel))  # noqa: B023
            self.steps += 1
        seen = self.simulator.finish()
        info = {
            "speed": float(seen.speed[0]),
            "crashed": bool(seen.parts[0, 0]),
            "action": action,
            "rewards": dict(zip(REWARDS, seen.parts[0].tolist(), strict=True)),
        }
        ended = bool(seen.terminated[0]), bool(seen.truncated[0])
        return seen.observations[0].copy(), float(seen.reward[0]), *ended, info

    def _observe(self) -> Any:
        return self.simulator.observe().copy()

    def _keep(self, write_rows: Any) -> None:
        rows = np.empty((self.simulator.scenario.bodies, _COLUMNS))
        self.off_road.append(not write_rows(rows))
        self.frames.append(rows)


class _Ego:
    """The ego, with the part of highway-env's vehicle interface that a supervision needs. The supervision replaces
    `act`."""

    LENGTH, WIDTH = Vehicle.LENGTH, Vehicle.WIDTH

    def __init__(self, env: CompiledHighwayEnv) -> None:
        self._env, self._worlds = env, env.simulator.worlds
        rules = env.simulator.scenario.rules
        self._inputs = env.simulator.scenario.inputs is not None
        if not self._inputs:
            self.target_speeds = tuple(rules.target_speeds.tolist())
        self.override = (np.nan, np.nan)

    def act(self, action: Any = None) -> None:
        """Begin a decision with its action; or, without an action, begin the next frame. Both clear the override."""
        if action is not None:
            self._env.simulator.begin(action)
        self.override = (np.nan, np.nan)

    @property
    def action(self) -> dict[str, float]:
        """The low-level action of the next frame: the override, else the inputs that the ego keeps from frame to frame,
        else NaN where its controllers choose. Acceleration [m/s^2] and front wheel angle [rad]."""
        kept = self._worlds.f[0, (ACCELERATION, STEERING), 0] if self._inputs else (np.nan, np.nan)
        acceleration, steering = np.where(np.isnan(self.override), kept, self.override).tolist()
        return {"acceleration": acceleration, "steering": steering}

    @action.setter
    def action(self, action: Mapping[str, float]) -> None:
        self.override = (float(action["acceleration"]), float(action["steering"]))

    def steering_control(self, lane: Any) -> float:
        """NaN: the kernel steers to the target lane."""
        return float("nan")

    @property
    def speed(self) -> float:
        """Speed of the ego [m/s]."""
        return float(self._worlds.f[0, SPEED, 0])

    @property
    def target_speed(self) -> float:
        """Target speed of the ego [m/s]."""
        return float(self._worlds.f[0, TARGET_SPEED, 0])

    @property
    def lane_index(self) -> tuple[str, str, int]:
        """The present lane, by highway-env's index."""
        return ("0", "1", int(self._worlds.g[0, LANE, 0]))

    @property
    def target_lane_index(self) -> tuple[str, str, int]:
        """The target lane, by highway-env's index."""
        return ("0", "1", int(self._worlds.g[0, TARGET, 0]))

    @target_lane_index.setter
    def target_lane_index(self, lane: tuple[str, str, int]) -> None:
        self._worlds.g[0, TARGET, 0] = lane[2]
