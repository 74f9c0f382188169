"""What the compiled simulator runs: highway-env's configuration as arrays, and a refusal of what it cannot do."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from highway_env import utils
from highway_env.envs.common.action import ContinuousAction, DiscreteMetaAction
from highway_env.envs.highway_env import HighwayEnv, HighwayEnvFast
from highway_env.road.lane import AbstractLane
from highway_env.vehicle.behavior import IDMVehicle, LinearVehicle
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.kinematics import Vehicle

from dynamics.errors import ConfigError
from dynamics.simulator.engine import Rules, View
from dynamics.simulator.layout import CONTINUOUS, EGO, IDM, LANE_COLUMNS, LINEAR, P
from dynamics.simulator.observe import FEATURES
from dynamics.state import FloatArray

__all__ = ["ACTIONS", "REWARDS", "Inputs", "Scenario", "constants_of", "kind_of", "scenario_of"]

ACTIONS = ("LANE_LEFT", "IDLE", "LANE_RIGHT", "FASTER", "SLOWER")
"""The labels of meta-actions, by the number that the kernels know them by."""

REWARDS = ("collision_reward", "right_lane_reward", "high_speed_reward", "on_road_reward")
"""What the reward is made of, in the order of `engine.Seen.parts`."""

_METHODS = (
    "act",
    "step",
    "acceleration",
    "desired_gap",
    "change_lane_policy",
    "mobil",
    "steering_control",
    "randomize_behavior",
    "follow_road",
    "clip_actions",
    "on_state_update",
    "handle_collisions",
)
_DRAWN = 6
"""Numbers that may be drawn for each vehicle: IDM's exponent, and the linear model's five."""
_IGNORED = frozenset(
    {
        "screen_width",
        "screen_height",
        "centering_position",
        "scaling",
        "show_trajectories",
        "render_agent",
        "offscreen_rendering",
        "real_time_rendering",
        "neighbour_vehicles_connected_lanes",
        "lane_change_reward",
    }
)
"""Keys that change nothing here: pictures, what a road that ends nowhere cannot show, a reward that is never read."""
_READ = frozenset(
    {
        "observation",
        "action",
        "simulation_frequency",
        "policy_frequency",
        "other_vehicles_type",
        "lanes_count",
        "vehicles_count",
        "controlled_vehicles",
        "initial_lane_id",
        "duration",
        "ego_spacing",
        "vehicles_density",
        "collision_reward",
        "right_lane_reward",
        "high_speed_reward",
        "on_road_reward",
        "reward_speed_range",
        "normalize_reward",
        "offroad_terminal",
        "manual_control",
    }
)


@dataclass(frozen=True, slots=True)
class Inputs:
    """How continuous actions become inputs, as `ContinuousAction.get_action` does it, with the dtype of the actions.

    Attributes
    ----------
    acceleration, steering : what -1 and 1 stand for [m/s^2, rad]; None for an input that is not there.
    clip : whether actions are clipped first.
    """

    acceleration: tuple[float, float] | None
    steering: tuple[float, float] | None
    clip: bool

    @property
    def size(self) -> int:
        """Numbers of an action."""
        return (self.acceleration is not None) + (self.steering is not None)

    def __call__(self, actions: Any) -> FloatArray:
        """Accelerations and steering angles of a batch of actions, (n, 2) float64."""
        actions = np.clip(actions, -1, 1) if self.clip else np.asarray(actions)
        out, column = np.zeros((len(actions), 2)), 0
        for k, bounds in enumerate((self.acceleration, self.steering)):
            if bounds is not None:
                out[:, k] = utils.lmap(actions[:, column], [-1, 1], bounds)
                column += 1
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Scenario:
    """An environment as the kernels take it.

    Attributes
    ----------
    env_id, config : what it is of, with all of its configuration.
    rules, view : for the kernels.
    inputs : of continuous actions; None for meta-actions.
    observation_space, action_space : of one environment.
    bodies : how many there are, the ego included.
    """

    env_id: str
    config: Mapping[str, Any]
    rules: Rules
    view: View
    inputs: Inputs | None
    observation_space: gym.spaces.Box
    action_space: gym.Space[Any]
    bodies: int


def scenario_of(env_id: str, config: Mapping[str, Any] | None = None) -> Scenario:
    """The scenario of an environment.

    Parameters
    ----------
    env_id : `highway-v0`, `highway-fast-v0`, or another id of their classes.
    config : what differs from its default configuration.

    Raises
    ------
    ConfigError
        If it needs what the compiled simulator cannot do; the message lists all of it.
    """
    kind = _class_of(env_id)
    whole = kind.default_config()
    whole.update(config or {})
    refused = [*_refused(whole), *_refused_observation(whole["observation"]), *_refused_action(whole["action"])]
    if refused:
        raise ConfigError(
            f"the compiled simulator cannot run {env_id} with {'; '.join(refused)}. It runs highway-v0 and "
            "highway-fast-v0 with Kinematics, DiscreteMetaAction or ContinuousAction, and IDM, Linear, Aggressive or "
            "Defensive vehicles; take highway-env itself for the rest"
        )
    rules, inputs, action_space = _rules(kind, whole)
    view, observation_space = _view(whole)
    return Scenario(env_id, whole, rules, view, inputs, observation_space, action_space, rules.numbers[1])


def _class_of(env_id: str) -> type[HighwayEnv]:
    try:
        spec = gym.spec(env_id)
    except gym.error.Error as error:
        raise ConfigError(f"there is no environment {env_id!r}: {error}") from None
    entry: Any = spec.entry_point
    kind: Any = gym.envs.registration.load_env_creator(entry) if isinstance(entry, str) else entry
    if kind not in (HighwayEnv, HighwayEnvFast):
        raise ConfigError(f"the compiled simulator runs highway-v0 and highway-fast-v0, not {env_id}")
    found: type[HighwayEnv] = kind
    return found


def _refused(config: Mapping[str, Any]) -> list[str]:
    refused = [f"{key}={config[key]!r}" for key in sorted(config.keys() - _READ - _IGNORED)]
    if config["controlled_vehicles"] != 1:
        refused.append(f"controlled_vehicles={config['controlled_vehicles']}")
    if config["manual_control"]:
        refused.append("manual_control")
    if not 1 <= config["lanes_count"] <= 62:
        refused.append(f"lanes_count={config['lanes_count']}")
    if config["simulation_frequency"] < config["policy_frequency"]:
        refused.append("fewer frames than decisions")
    try:
        kind_of(utils.class_from_path(config["other_vehicles_type"]))
    except (ConfigError, AttributeError, ImportError, ValueError):
        refused.append(f"other_vehicles_type={config['other_vehicles_type']}")
    return refused


def _refused_observation(observation: Mapping[str, Any]) -> list[str]:
    if observation["type"] != "Kinematics":
        return [f"observation {observation['type']}"]
    unknown = set(observation.get("features") or ()) - set(FEATURES)
    return [f"features {sorted(unknown)}"] if unknown else []


def _refused_action(action: Mapping[str, Any]) -> list[str]:
    if action["type"] not in ("DiscreteMetaAction", "ContinuousAction"):
        return [f"action {action['type']}"]
    if action.get("dynamical"):
        return ["dynamical actions"]
    speeds = action.get("target_speeds")
    return ["fewer than two target_speeds"] if speeds is not None and len(speeds) < 2 else []


def kind_of(vehicle: type) -> int:
    """How vehicles of a class drive: `IDM` or `LINEAR`. Its constants may be its own, its methods may not.

    Raises
    ------
    ConfigError
        If it drives in another way.
    """
    for kind, base in ((LINEAR, LinearVehicle), (IDM, IDMVehicle)):
        if issubclass(vehicle, base) and all(_same(vehicle, base, name) for name in _METHODS):
            return kind
    raise ConfigError(f"{vehicle.__name__} does not drive as IDMVehicle or LinearVehicle do")


def _same(vehicle: type, base: type, name: str) -> bool:
    mine: Callable[..., Any] = getattr(vehicle, name)
    return mine is getattr(base, name)


def constants_of(vehicle: Any) -> FloatArray:
    """What stays of a vehicle, or of a class of them, (P,); 0 for what it has not (see `layout`)."""
    numbers = np.zeros(P)
    root = 2 * np.sqrt(-getattr(vehicle, "COMFORT_ACC_MAX", 0.0) * getattr(vehicle, "COMFORT_ACC_MIN", 0.0))
    names: tuple[Any, ...] = (
        "LENGTH",
        "WIDTH",
        np.sqrt(vehicle.LENGTH**2 + vehicle.WIDTH**2),
        "MAX_SPEED",
        "MIN_SPEED",
        "ACC_MAX",
        "COMFORT_ACC_MAX",
        root,
        "DISTANCE_WANTED",
        "TIME_WANTED",
        "DELTA",
        "POLITENESS",
        "LANE_CHANGE_MIN_ACC_GAIN",
        "LANE_CHANGE_MAX_BRAKING_IMPOSED",
        "LANE_CHANGE_DELAY",
    )
    for k, name in enumerate(names):
        numbers[k] = getattr(vehicle, name, 0.0) if isinstance(name, str) else name
    numbers[len(names) : len(names) + 3] = getattr(vehicle, "ACCELERATION_PARAMETERS", 0.0)
    numbers[len(names) + 3 :] = getattr(vehicle, "STEERING_PARAMETERS", 0.0)
    return numbers


def _ranges(vehicle: Any) -> FloatArray:
    """What is drawn for each vehicle of a class, (_DRAWN, 2)."""
    ranges = np.zeros((_DRAWN, 2))
    ranges[0] = getattr(vehicle, "DELTA_RANGE", (0.0, 0.0))
    if issubclass(vehicle, LinearVehicle):
        ranges[1:4] = np.transpose(vehicle.ACCELERATION_RANGE)
        ranges[4:6] = np.transpose(vehicle.STEERING_RANGE)
    return ranges


def lanes_of(count: int) -> FloatArray:
    """The lanes of highway-env's straight road, (count, LANE_COLUMNS)."""
    lanes = np.zeros((count, LANE_COLUMNS))
    lanes[:] = 0.0, AbstractLane.DEFAULT_WIDTH, 10_000.0, 30.0
    lanes[:, 0] = np.arange(count) * AbstractLane.DEFAULT_WIDTH
    return lanes


def _rules(kind: type[HighwayEnv], config: Mapping[str, Any]) -> tuple[Rules, Inputs | None, gym.Space[Any]]:
    traffic = utils.class_from_path(config["other_vehicles_type"])
    action, n = config["action"], config["lanes_count"]
    inputs, labels, speeds = _actions(action)
    ego = constants_of(MDPVehicle if inputs is None else Vehicle)
    if inputs is not None and action.get("speed_range"):
        ego[4], ego[3] = action["speed_range"]
    first = config["initial_lane_id"]
    frames = int(config["simulation_frequency"] // config["policy_frequency"])
    kinds = EGO if inputs is None else CONTINUOUS, kind_of(traffic)
    slow, fast = (float(v) for v in config["reward_speed_range"])
    rules = Rules(
        lanes=lanes_of(n),
        numbers=(
            frames,
            1 + int(config["vehicles_count"]),
            -1 if first is None else int(first),
            int(kind is not HighwayEnvFast),
            *kinds,
        ),
        times=(1 / config["simulation_frequency"], 1 / config["policy_frequency"], float(config["duration"])),
        spacings=(float(config["ego_spacing"]), 1 / config["vehicles_density"], float(np.exp(-5 / 40 * n))),
        constants=np.array([ego, constants_of(traffic)]),
        ranges=_ranges(traffic),
        target_speeds=speeds,
        labels=labels,
        reward=(
            float(config["collision_reward"]),
            float(config["right_lane_reward"]),
            float(config["high_speed_reward"]),
            float(config.get("on_road_reward", 0)),
            slow,
            fast,
            bool(config["normalize_reward"]),
            bool(config["offroad_terminal"]),
        ),
    )
    if inputs is None:
        return rules, None, gym.spaces.Discrete(len(labels))
    return rules, inputs, gym.spaces.Box(-1.0, 1.0, (inputs.size,), np.float32)


def _actions(action: Mapping[str, Any]) -> tuple[Inputs | None, Any, FloatArray]:
    speeds = MDPVehicle.DEFAULT_TARGET_SPEEDS if action.get("target_speeds") is None else action["target_speeds"]
    speeds = np.array(speeds, dtype=np.float64)
    along, across = action.get("longitudinal", True), action.get("lateral", True)
    if not along and not across:
        raise ConfigError("an action needs longitudinal or lateral control, or both")
    if action["type"] == "ContinuousAction":
        ranges = (
            (action.get("acceleration_range") or ContinuousAction.ACCELERATION_RANGE) if along else None,
            (action.get("steering_range") or ContinuousAction.STEERING_RANGE) if across else None,
        )
        return Inputs(*ranges, clip=action.get("clip", True)), np.zeros(0, np.int64), speeds
    kind = DiscreteMetaAction
    names = kind.ACTIONS_ALL if along and across else kind.ACTIONS_LONGI if along else kind.ACTIONS_LAT
    return None, np.array([ACTIONS.index(names[i]) for i in sorted(names)], dtype=np.int64), speeds


def _view(config: Mapping[str, Any]) -> tuple[View, gym.spaces.Box]:
    asked, n = config["observation"], config["lanes_count"]
    features = list(asked.get("features") or ("presence", "x", "y", "vx", "vy"))
    ranges = asked.get("features_range")
    if not ranges:
        far, fast, side = 5.0 * Vehicle.MAX_SPEED, 2 * Vehicle.MAX_SPEED, AbstractLane.DEFAULT_WIDTH * n
        ranges = {"x": [-far, far], "y": [-side, side], "vx": [-fast, fast], "vy": [-fast, fast]}
    table = np.array([ranges.get(name, (math.nan, math.nan)) for name in features], dtype=np.float64)
    switches = (
        bool(asked.get("absolute", False)),
        bool(asked.get("normalize", True)),
        bool(asked.get("clip", True)),
        bool(asked.get("see_behind", False)),
        asked.get("order", "sorted") == "shuffled",
        bool(asked.get("include_obstacles", True)),
    )
    rows = int(asked.get("vehicles_count", 5))
    view = View(np.array([FEATURES.index(name) for name in features], dtype=np.int64), table, switches)
    return view, gym.spaces.Box(-np.inf, np.inf, (rows, len(features)), np.float32)
