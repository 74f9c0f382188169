"""ComplexRoads-v0: merges, intersections, roundabouts and straights in one network, from any spawn to any exit.

After Dong et al. 2023, Comprehensive Training and Evaluation on Deep Reinforcement Learning for Automated Driving in
Various Simulated Driving Maneuvers, arXiv 2306.11466.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.observation import ObservationType, observation_factory
from highway_env.vehicle.controller import ControlledVehicle, MDPVehicle

from dynamics.road_networks.traffic.priority_road import PriorityRoad
from dynamics.vehicle.action_grid import make_action_type
from evaluation.scenarios.course import SUBMAPS, ScenarioMap, build_map, check_counts
from evaluation.scenarios.traffic import ENTRY, populate, recycle
from evaluation.wrappers.on_lane_reward import OnLane, on_lane_reward
from evaluation.wrappers.signed_lane import extend_observation, extended_space, lane_offset
from shield.errors import ConfigError

__all__ = ["ARRIVAL", "ComplexRoadsEnv"]

ARRIVAL = 25.0
"""Distance along the road to its exit at which the ego has arrived [m], as in highway-env's intersection."""


class ComplexRoadsEnv(AbstractEnv):  # type: ignore[misc]
    """A map of two merges, two intersections, two roundabouts and four straights, with IDM traffic.

    The goal of the ego is the exit `destination`. `info` contains the success ("success", and "is_success" for
    Stable-Baselines3) and the name of the exit ("destination"). An episode ends at the exit, in a crash, or after
    `duration`.

    Parameters
    ----------
    config : changes to `default_config`. Beside highway-env's own keys:

        - `submap_counts`: number of pieces of each kind "merge", "intersection", "roundabout" and "straight";
        - `vehicle_density`: number of other vehicles;
        - `random_start`: whether the seed draws the ego's entry, or it is always the first one;
        - `destination`: name of an exit; None to draw one from the seed;
        - `use_signed_lane_obs`: whether observations contain the numbers of `lane_offset`;
        - `on_lane_reward`: options of the reward, those of `OnLane`;
        - `offroad_terminal`: whether an episode ends when the ego leaves the road;
        - `duration` [s].

        `actions_per_axis` of a `DiscreteAction` may be two numbers, of throttle and of steering.
    render_mode : None, "rgb_array" or "human".

    Raises
    ------
    ConfigError
        If a key is unknown or a value cannot be used; the message lists what is valid.

    Examples
    --------
    >>> env = ComplexRoadsEnv({"submap_counts": {"merge": 1, "intersection": 1}, "vehicle_density": 2})
    >>> observation, info = env.reset(seed=1)
    >>> env.action_space.n, len(env.road.vehicles), info["destination"] in env.course.exits
    (np.int64(45), 3, True)
    """

    course: ScenarioMap
    changes_between_decisions_only = True
    """Vehicles enter again only between two decisions; the compiled copy of the traffic reads this."""
    makes_grids = True
    """The environment makes grids of actions itself (`dynamics.traffic.crossing.make`)."""

    def __init__(self, config: dict[str, Any] | None = None, render_mode: str | None = None) -> None:
        super().__init__(config, render_mode)

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """The configuration of the paper; ranges and frequencies are this library's."""
        return {
            **super().default_config(),
            "observation": {
                "type": "Kinematics",
                "vehicles_count": 10,
                "features": ["presence", "x", "y", "vx", "vy", "cos_h", "sin_h"],
                "features_range": {"x": [-100, 100], "y": [-100, 100], "vx": [-20, 20], "vy": [-20, 20]},
            },
            "action": {"type": "DiscreteAction", "actions_per_axis": [5, 9]},
            "submap_counts": dict(SUBMAPS),
            "vehicle_density": 10,
            "random_start": False,
            "destination": None,
            "use_signed_lane_obs": True,
            "on_lane_reward": {},
            "offroad_terminal": False,
            "duration": 1000,
            "policy_frequency": 5,
            "neighbour_vehicles_connected_lanes": True,
            "screen_width": 600,
            "screen_height": 600,
            "centering_position": [0.5, 0.5],
            "scaling": 4.0,
        }

    def configure(self, config: dict[str, Any] | None) -> None:
        """Change the configuration, after a check of all of it.

        Raises
        ------
        ConfigError
            If a key is unknown or a value is out of range.
        """
        _check({**self.config, **(config or {})}, list(self.default_config()))
        super().configure(config)

    def define_spaces(self) -> None:
        """Make the spaces of observations and actions."""
        self.observation_type = observation_factory(self, self.config["observation"])
        if self.config["use_signed_lane_obs"]:
            self.observation_type = _SignedObservation(self, self.observation_type)
        self.action_type = make_action_type(self, self.config["action"])
        self.observation_space = self.observation_type.space()
        self.action_space = self.action_type.space()

    def _reset(self) -> None:
        self.course = build_map(self.config["submap_counts"])
        self.road = PriorityRoad(
            network=self.course.network, np_random=self.np_random, record_history=self.config["show_trajectories"]
        )
        self.destination = self._drawn_destination()
        self.vehicle = ego = self._make_ego()
        self.road.vehicles.append(ego)
        populate(self.road, self.course, self.config["other_vehicles_type"], self.config["vehicle_density"], ego)

    def _drawn_destination(self) -> str:
        exits, wanted = list(self.course.exits), self.config["destination"]
        drawn = exits[int(self.np_random.integers(len(exits)))]
        if wanted is not None and wanted not in exits:
            raise ConfigError(f"there is no exit {wanted!r}; have {', '.join(exits)}")
        return drawn if wanted is None else str(wanted)

    def _make_ego(self) -> Any:
        spawns, lane_id = self.course.spawns, 1
        start, end = spawns[0]
        if self.config["random_start"]:
            start, end = spawns[int(self.np_random.integers(len(spawns)))]
            lane_id = int(self.np_random.integers(len(self.course.network.graph[start][end])))
        lane = self.course.network.get_lane((start, end, lane_id))
        place = lane.position(ENTRY, 0.0), lane.heading_at(ENTRY)
        ego = self.action_type.vehicle_class(self.road, *place, speed=lane.speed_limit)
        if isinstance(ego, ControlledVehicle):
            ego.plan_route_to(self.destination)
        if isinstance(ego, MDPVehicle):
            ego.speed_index = ego.speed_to_index(lane.speed_limit)
            ego.target_speed = ego.index_to_speed(ego.speed_index)
        return ego

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Execute one decision; then vehicles at an exit enter again."""
        result = super().step(action)
        recycle(self.road, self.course, self.vehicle)
        return result  # type: ignore[no-any-return]

    def _reward(self, action: Any) -> float:
        terms, ego = OnLane.of(self.config["on_lane_reward"]), self.vehicle
        return on_lane_reward(lane_offset(ego), float(ego.speed), bool(ego.crashed), terms)

    def _rewards(self, action: Any) -> dict[str, float]:
        ego, offset = self.vehicle, lane_offset(self.vehicle)
        return {
            "collision": float(ego.crashed),
            "heading": float(np.cos(offset.heading)),
            "distance": abs(offset.distance),
            "speed": float(ego.speed),
            "on_lane": float(ego.on_road),
            "arrived": float(self.has_arrived(ego)),
        }

    def has_arrived(self, vehicle: Any) -> bool:
        """Whether a vehicle is on the road to the ego's exit, at least `ARRIVAL` along it, and has not crashed."""
        if vehicle.crashed or vehicle.lane_index[:2] != self.course.exits[self.destination]:
            return False
        return bool(vehicle.on_road and vehicle.lane.local_coordinates(vehicle.position)[0] >= ARRIVAL)

    def _is_terminated(self) -> bool:
        left = self.config["offroad_terminal"] and not self.vehicle.on_road
        return bool(self.vehicle.crashed or self.has_arrived(self.vehicle) or left)

    def _is_truncated(self) -> bool:
        return bool(self.time >= self.config["duration"])

    def _info(self, obs: Any, action: Any | None = None) -> dict[str, Any]:
        arrived = self.has_arrived(self.vehicle)
        return {
            **super()._info(obs, action),
            "success": arrived,
            "is_success": arrived,
            "destination": self.destination,
        }


class _SignedObservation(ObservationType):  # type: ignore[misc]
    """An observation extended by the signed numbers of `lane_offset`."""

    def __init__(self, env: AbstractEnv, inner: ObservationType) -> None:
        super().__init__(env)
        self._inner, self._space = inner, extended_space(inner.space())

    def space(self) -> Any:
        return self._space

    def observe(self) -> Any:
        return extend_observation(self._inner.observe(), lane_offset(self.observer_vehicle), self._space)


def _check(config: dict[str, Any], valid: list[str]) -> None:
    for key in config:
        if key not in valid:
            raise ConfigError(f"unknown key {key!r} of ComplexRoads-v0; have {', '.join(sorted(valid))}")
    check_counts(config["submap_counts"])
    density, duration = config["vehicle_density"], config["duration"]
    if isinstance(density, bool) or not isinstance(density, int | np.integer) or density < 0:
        raise ConfigError(f"vehicle_density is a whole number of vehicles from 0 on, not {density!r}")
    if isinstance(duration, bool) or not isinstance(duration, int | float) or not duration > 0:
        raise ConfigError(f"duration is a time above 0 [s], not {duration!r}")
    for key in ("random_start", "use_signed_lane_obs", "offroad_terminal"):
        if not isinstance(config[key], bool | np.bool_):
            raise ConfigError(f"{key} is true or false, not {config[key]!r}")
    OnLane.of(config["on_lane_reward"])
