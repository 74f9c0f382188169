"""An environment on a road network as arrays, for the compiled episodes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from itertools import pairwise
from typing import Any, cast

import gymnasium as gym
import numpy as np
from highway_env.envs.common.action import ContinuousAction
from highway_env.envs.common.observation import TimeToCollisionObservation
from highway_env.envs.intersection_env import IntersectionEnv
from highway_env.vehicle.dynamics import BicycleVehicle

from dynamics.errors import ConfigError, PlatformError
from dynamics.highway_simulator.kinds import constants_of, kind_of, ranges_of
from dynamics.highway_simulator.layout import (
    ACC_MAX,
    COMFORT,
    CONTINUOUS,
    EGO,
    LANE,
    MAX_SPEED,
    MIN_SPEED,
    OBSTACLE,
    TARGET,
    P,
)
from dynamics.highway_simulator.live import load_body
from dynamics.highway_simulator.observe import FEATURES
from dynamics.highway_simulator.scenario import ACTIONS, COPIED, ActionScaling
from dynamics.road_networks.episodes.arrivals import ArrivalRules
from dynamics.road_networks.episodes.observe import AHEAD, EXIT, KINEMATICS, RoadObservationConfig
from dynamics.road_networks.episodes.places import PlacementTables, placement_tables
from dynamics.road_networks.episodes.placing import ResetTables
from dynamics.road_networks.episodes.rewards import (
    CROSSING,
    EXITING,
    MERGING,
    NAMES,
    ROUND,
    TURNING,
    TWO_WAY,
    RewardRules,
)
from dynamics.road_networks.episodes.step_kernels import EpisodeRules
from dynamics.road_networks.episodes.supported_configs import (
    environment_kind,
    is_supported_environment,
    unsupported_road_settings,
)
from dynamics.road_networks.episodes.time_to_collision import ROWS
from dynamics.road_networks.geometry.layout import ACROSS, ALONG, ROAD, F, G
from dynamics.road_networks.geometry.network import Network, index_of, network_of
from dynamics.road_networks.simulation.frame_kernels import NetworkRules
from dynamics.road_networks.simulation.supported_traffic import exits_of, traffic_regulation_of
from dynamics.scenes.registration import spec_of
from dynamics.state import FloatArray, IntArray
from dynamics.traffic.crossing import make

__all__ = ["RoadScenario", "on_roads", "road_scenario_of"]

_MOST = 64
"""Greatest number of vehicles that may enter an intersection in an episode."""
_CONTROL_LIMITS = (9.8, 5.0)


@dataclass(frozen=True, slots=True, eq=False)
class RoadScenario:
    """An environment in the form of the kernels.

    Attributes
    ----------
    env_id, config : its id, and its whole configuration.
    rules : for the kernels.
    lanes : the number of each lane by highway-env's index.
    inputs : conversion of continuous actions; None for meta-actions.
    observation_space, action_space : of one environment. shape : of an observation in the kernels.
    bodies, entries : greatest number of bodies, and of entries of a route.
    names : of the terms of the reward.
    """

    env_id: str
    config: Mapping[str, Any]
    rules: EpisodeRules
    lanes: Mapping[tuple[str, str, int], int]
    inputs: ActionScaling | None
    observation_space: gym.spaces.Box
    action_space: gym.Space[Any]
    shape: tuple[int, int]
    bodies: int
    entries: int
    names: tuple[str, ...]

    @property
    def kind(self) -> int:
        """MERGING to CROSSING (see `rewards`)."""
        return self.rules.worth.kind


def road_scenario_of(env_id: str, config: Mapping[str, Any] | None = None) -> RoadScenario:
    """The scenario of an environment.

    Parameters
    ----------
    env_id : merge, roundabout, exit, two-way, u-turn or intersection, in any version.
    config : changes of the default configuration.

    Raises
    ------
    ConfigError
        If the compiled episodes do not support the configuration; the message lists all unsupported entries.
    PlatformError
        If the installed version of highway-env is not the version of this copy.
    """
    installed = version("highway-env")
    if not installed.startswith(f"{COPIED}."):
        raise PlatformError(f"the compiled roads are a copy of highway-env {COPIED}; {installed} is installed")
    base = _made(env_id, config)
    lanes = index_of(base.road.network)
    network = network_of(base.road.network, bool(base.road.neighbour_vehicles_connected_lanes), exits_of(base))
    places = placement_tables(base, lanes)
    goals = places.goals if places is not None else tuple(f"o{k}" for k in range(4))
    ways = _ways(base.road.network, network, lanes, goals)
    action, inputs = base.action_type, None
    if isinstance(action, ContinuousAction):
        inputs = ActionScaling(
            action.acceleration_range if action.longitudinal else None,
            action.steering_range if action.lateral else None,
            action.clip,
        )
    labels = {} if inputs else action.actions
    target_speeds = np.zeros(1) if inputs else np.array(action.target_speeds, float)
    frequency, decisions = base.config["simulation_frequency"], base.config["policy_frequency"]
    drive = NetworkRules(
        network=network,
        regulation=traffic_regulation_of(base)._replace(stay=0, phase=0),
        numbers=(int(frequency // decisions), -1),
        times=(1 / frequency, 1 / decisions),
        target_speeds=target_speeds,
        labels=np.array([ACTIONS.index(labels[k]) for k in sorted(labels)], np.int64),
        control_limits=_CONTROL_LIMITS,
    )
    worth = _worth(base, lanes)._replace(decisions=int(spec_of(env_id).max_episode_steps or 0))
    view, shape = _view(base, lanes)
    rules = EpisodeRules(drive, _scene(base, lanes, places, ways, target_speeds), _coming(base, lanes), view, worth)
    return RoadScenario(
        env_id,
        base.config,
        rules,
        lanes,
        inputs,
        base.observation_space,
        base.action_space,
        shape,
        _bodies(base, places),
        ways.shape[2] + 1,
        NAMES[worth.kind],
    )


def on_roads(env_id: str) -> bool:
    """Whether the episodes of an environment's class are compiled here.

    Raises
    ------
    ConfigError
        If there is no such environment.
    """
    return is_supported_environment(_class_of(env_id)[1])


def _class_of(env_id: str) -> tuple[Any, Any]:
    """The registration of an environment, and the class or function that makes it."""
    try:
        spec = spec_of(env_id)
    except (gym.error.Error, ImportError) as error:
        raise ConfigError(f"there is no environment {env_id!r}: {error}") from None
    entry: Any = spec.entry_point
    return spec, gym.envs.registration.load_env_creator(entry) if isinstance(entry, str) else entry


def _made(env_id: str, config: Mapping[str, Any] | None) -> Any:
    """The environment itself, unwrapped and reset."""
    spec, kind = _class_of(env_id)
    if not isinstance(kind, type):
        raise ConfigError(f"{env_id} is made by {kind!r}, not by a class of environments")
    environment_kind(kind)
    others = sorted(spec.kwargs.keys() - {"config", "render_mode"})
    if others or spec.additional_wrappers:
        raise ConfigError(f"{env_id} is registered with {', '.join(others) or 'wrappers'}; take highway-env itself")
    whole = cast(Any, kind).default_config()
    whole.update((spec.kwargs.get("config") or {}) if config is None else config)
    refused = unsupported_road_settings(kind, whole)
    if environment_kind(kind) != CROSSING and whole["action"]["type"] == "ContinuousAction":
        refused.append("ContinuousAction, which its own reward does not take")
    if refused:
        raise ConfigError(f"the compiled episodes cannot run {env_id} with {'; '.join(refused)}")
    base = cast(Any, make(env_id, whole).unwrapped)
    base.reset(seed=0)
    return base


def _ways(roads: Any, network: Network, lanes: Mapping[tuple[str, str, int], int], goals: tuple[str, ...]) -> IntArray:
    """The roads from each node to each goal, by highway-env's planning of routes."""
    nodes = list(dict.fromkeys([*roads.graph, *(to for outs in roads.graph.values() for to in outs)]))
    found: dict[tuple[int, int], list[int]] = {}
    for n, node in enumerate(nodes):
        for k, goal in enumerate(goals):
            try:
                path = roads.shortest_path(node, goal)
            except KeyError:
                path = []
            found[n, k] = [int(network.ids[lanes[a, b, 0], ROAD]) for a, b in pairwise(path)]
    table = np.full((len(nodes), max(len(goals), 1), max([1, *map(len, found.values())]) + 1), -1, np.int64)
    for (n, k), path in found.items():
        table[n, k, : len(path)] = path
    return table


def _bodies(base: Any, places: PlacementTables | None) -> int:
    """Greatest number of bodies."""
    if places is not None:
        return sum(row.many for row in places.rows) + len(base.road.objects)
    comers = math.ceil(base.config["duration"] * base.config["policy_frequency"]) + 2
    return int(max(base.config["initial_vehicle_count"], 1) + 1 + min(comers, _MOST))


def _scene(
    base: Any,
    lanes: Mapping[tuple[str, str, int], int],
    places: PlacementTables | None,
    ways: IntArray,
    target_speeds: FloatArray,
) -> ResetTables:
    """The tables of a reset, with the obstacles of the environment's road."""
    traffic = next(type(v) for v in base.road.vehicles if v is not base.vehicle)
    places = places or PlacementTables([])
    rows, choices = places.tables()
    count = len(base.road.objects)
    f, g, p = np.zeros((F, count)), np.zeros((G, count), np.int64), np.zeros((P, count))
    for k, body in enumerate(base.road.objects):
        load_body(body, k, OBSTACLE, f, g, p)
        g[[LANE, TARGET], k] = lanes[body.lane_index]
        f[[ALONG, ACROSS], k] = body.lane.local_coordinates(body.position)
    stretches = np.zeros((len(lanes), 2))
    for lane, stretch in places.stretches.items():
        stretches[lane] = stretch
    ego, inputs = constants_of(base.vehicle), isinstance(base.action_type, ContinuousAction)
    if inputs:
        ego[[ACC_MAX, COMFORT]] = _CONTROL_LIMITS
    if inputs and base.action_type.speed_range:
        ego[[MIN_SPEED, MAX_SPEED]] = base.action_type.speed_range
    return ResetTables(
        rows=rows,
        choices=choices,
        constants=np.array([ego, constants_of(traffic)]),
        kind=kind_of(traffic),
        ranges=ranges_of(traffic),
        ego=(CONTINUOUS if inputs else EGO, int(isinstance(base.vehicle, BicycleVehicle))),
        target_speeds=target_speeds,
        ways=ways,
        roads=np.array(places.roads, np.int64).reshape(-1, 2),
        stretches=stretches,
        apart=float(places.apart),
        along=places.along,
        odds=np.array(places.odds, float),
        packed=float(places.packed),
        standing=f,
        standing_ids=g,
        standing_sizes=p,
    )


def _coming(base: Any, lanes: Mapping[tuple[str, str, int], int]) -> ArrivalRules:
    """The new vehicles of an intersection; without entrances for other roads."""
    if not isinstance(base, IntersectionEnv):
        return ArrivalRules(np.zeros(0, np.int64), np.zeros(0), 0, 0.0, -1)
    config = base.config
    count, goal = int(config["initial_vehicle_count"]), config["destination"]
    arms = np.array([lanes[f"o{k}", f"ir{k}", 0] for k in range(4)], np.int64)
    places = np.linspace(0, 80, count)[: max(count - 1, 0)]
    if goal and goal not in ("o0", "o1", "o2", "o3"):
        raise ConfigError(f"the destinations at an intersection are o0 to o3, not {goal!r}")
    number = int(goal[1]) if goal else -1
    return ArrivalRules(arms, places, int(config["simulation_frequency"]), float(config["spawn_probability"]), number)


def _worth(base: Any, lanes: Mapping[tuple[str, str, int], int]) -> RewardRules:
    """The parameters of rewards and ends of episodes."""
    config, kind = base.config, environment_kind(type(base))
    weights = np.zeros(5)
    weights[: len(NAMES[kind])] = [float(config.get(name, 0)) for name in NAMES[kind]]
    found = (-1, -1)
    least, most = float(config.get("collision_reward", 0)), float(config.get("high_speed_reward", 0))
    if kind == MERGING:
        found = (lanes.get(("b", "c", 2), -1), -1)
        least, most = least + float(config["merging_speed_reward"]), most + float(config["right_lane_reward"])
    elif kind == EXITING:
        found = (lanes["1", "2", int(config["lanes_count"])], lanes["2", "exit", 0])
        most = float(config["goal_reward"])
    elif kind == TURNING:
        most += float(config["left_lane_reward"])
    elif kind == CROSSING:
        most = float(config["arrived_reward"])
    read = kind not in (ROUND, TWO_WAY)
    slow, fast = (float(v) for v in config.get("reward_speed_range", (0.0, 1.0))) if read else (0.0, 1.0)
    ends = kind == MERGING
    return RewardRules(
        kind=kind,
        weights=weights,
        speeds=(slow, fast),
        rewards=(least, most),
        normalised=bool(config.get("normalize_reward", ends)),
        strict=bool(config.get("offroad_terminal", False)),
        lanes=found,
        end=float(getattr(base, "end_position", 370)) if ends else math.inf,
        duration=math.inf if ends or "duration" not in config else float(config["duration"]),
        decisions=0,
    )


def _view(base: Any, lanes: Mapping[tuple[str, str, int], int]) -> tuple[RoadObservationConfig, tuple[int, int]]:
    """The configuration of the observation, and its shape in the kernels."""
    seen = base.observation_type
    if isinstance(seen, TimeToCollisionObservation):
        step = 1 / base.config["policy_frequency"]
        steps = int(seen.horizon / step)
        nothing_else = np.zeros(0, np.int64), np.zeros((0, 2)), cast(Any, (False,) * 8)
        return RoadObservationConfig(AHEAD, *nothing_else, -1, steps, step), (ROWS, steps)
    is_exit = base.config["observation"]["type"] == "ExitObservation"
    ranges, nothing = seen.features_range or {}, (math.nan, math.nan)
    table = np.array([ranges.get(name, nothing)[:2] for name in seen.features], float)
    switches = (
        bool(seen.absolute),
        bool(seen.normalize),
        bool(seen.clip),
        bool(seen.see_behind),
        seen.order == "shuffled",
        bool(seen.include_obstacles) and not is_exit,
        is_exit or seen.order == "sorted",
        bool(seen.observe_intentions),
    )
    features = np.array([FEATURES.index(name) for name in seen.features], np.int64)
    exit_lane = -1
    if is_exit:
        exit_lane = lanes[max(key for key in lanes if key[:2] == ("1", "2"))]
    view = RoadObservationConfig(EXIT if is_exit else KINEMATICS, features, table, switches, exit_lane, 0, 0.0)
    return view, (int(seen.vehicles_count), len(seen.features))
