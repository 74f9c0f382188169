"""highway-env's configuration as arrays for the compiled simulator, or an error if it is not supported."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import gymnasium as gym
import numpy as np
from highway_env import utils
from highway_env.envs.common.action import ContinuousAction, DiscreteMetaAction
from highway_env.envs.common.observation import KinematicObservation, OccupancyGridObservation
from highway_env.envs.highway_env import HighwayEnv, HighwayEnvFast
from highway_env.road.lane import AbstractLane
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.kinematics import Vehicle

from dynamics.errors import ConfigError, PlatformError
from dynamics.highway_simulator.arrays import ObservationConfig, Rules
from dynamics.highway_simulator.grid import LAYERS
from dynamics.highway_simulator.kinds import constants_of, kind_of, mix_of, ranges_of
from dynamics.highway_simulator.layout import CONTINUOUS, EGO, LANE_COLUMNS
from dynamics.highway_simulator.observe import FEATURES
from dynamics.highway_simulator.own_methods import check_own_methods
from dynamics.highway_simulator.supported_configs import unsupported_highway_settings
from dynamics.scenes.registration import spec_of
from dynamics.state import FloatArray

__all__ = ["ACTIONS", "REWARDS", "ActionScaling", "Scenario", "scenario_of", "scenario_of_live"]

ACTIONS = ("LANE_LEFT", "IDLE", "LANE_RIGHT", "FASTER", "SLOWER")
"""The labels of meta-actions, by their number in the kernels."""

COPIED = "1.12"
"""The version of highway-env. Traffic of earlier versions drives differently."""

_MOVES = (
    "action",
    "simulation_frequency",
    "policy_frequency",
    "other_vehicles_type",
    "lanes_count",
    "controlled_vehicles",
    "manual_control",
)
"""Settings that determine how the traffic of a live highway moves."""

REWARDS = ("collision_reward", "right_lane_reward", "high_speed_reward", "on_road_reward")
"""The terms of the reward, in the order of `step_kernels.Seen.parts`."""


@dataclass(frozen=True, slots=True)
class ActionScaling:
    """Conversion of continuous actions to inputs, as `ContinuousAction.get_action` does it, with the dtype of the
    actions.

    Attributes
    ----------
    acceleration, steering : the inputs for -1 and 1 [m/s^2, rad]; None for an input that is absent.
    clip : whether actions are clipped first.
    """

    acceleration: tuple[float, float] | None
    steering: tuple[float, float] | None
    clip: bool

    @property
    def size(self) -> int:
        """Number of components of an action."""
        return (self.acceleration is not None) + (self.steering is not None)

    def __call__(self, actions: Any) -> FloatArray:
        """Accelerations [m/s^2] and steering angles [rad] of a batch of actions, (n, 2) float64."""
        actions = np.clip(actions, -1, 1) if self.clip else np.asarray(actions)
        out, column = np.zeros((len(actions), 2)), 0
        for k, bounds in enumerate((self.acceleration, self.steering)):
            if bounds is not None:
                out[:, k] = utils.lmap(actions[:, column], [-1, 1], bounds)
                column += 1
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Scenario:
    """An environment in the form of the kernels.

    Attributes
    ----------
    env_id, config : its id, and its whole configuration.
    rules, view : for the kernels.
    inputs : conversion of continuous actions; None for meta-actions.
    observation_space, action_space : of one environment.
    bodies : number of bodies, the ego included.
    observes : whether its observation is that of the environment.
    """

    env_id: str
    config: Mapping[str, Any]
    rules: Rules
    view: ObservationConfig
    inputs: ActionScaling | None
    observation_space: gym.spaces.Box
    action_space: gym.Space[Any]
    bodies: int
    observes: bool = True


def scenario_of(env_id: str, config: Mapping[str, Any] | None = None, observes: bool = True) -> Scenario:
    """The scenario of an environment.

    Parameters
    ----------
    env_id : `highway-v0`, `highway-fast-v0`, or another id of their classes.
    config : changes of the default configuration.
    observes : False if only states are needed; then the environment may have any observation.

    Raises
    ------
    ConfigError
        If the compiled simulator does not support the configuration; the message lists all unsupported entries.
    PlatformError
        If the installed version of highway-env is not the version of this copy.
    """
    kind, registered = _class_of(env_id)
    whole = kind.default_config()
    whole.update(registered if config is None else config)
    return _scenario(env_id, kind, whole, observes)


def scenario_of_live(base: Any, observes: bool = True) -> Scenario:
    """The scenario of a live environment, unwrapped, in its present configuration.

    Parameters
    ----------
    base : an environment of `HighwayEnv` or `HighwayEnvFast`, with any id. Without `observes`, also of a derived class
        with its own rewards, observations, ends of episodes or vehicles (see `own_methods`).
    observes : as of `scenario_of`. Without it, settings that only the derived class reads are ignored.

    Raises
    ------
    ConfigError
        If the compiled simulator does not support the configuration; the message lists all unsupported entries.
    PlatformError
        As of `scenario_of`.
    """
    env_id = type(base).__name__ if base.spec is None else base.spec.id
    if observes:
        if type(base) not in (HighwayEnv, HighwayEnvFast):
            raise ConfigError(
                f"the compiled simulator observes and rewards as HighwayEnv and HighwayEnvFast do, not as {env_id} does"
            )
        return _scenario(env_id, type(base), dict(base.config), observes)
    if not isinstance(base, HighwayEnv):
        raise ConfigError(f"the compiled simulator runs straight highways, HighwayEnv, not {env_id}")
    check_own_methods(base)
    kind = HighwayEnvFast if isinstance(base, HighwayEnvFast) else HighwayEnv
    whole = kind.default_config()
    whole.update({key: base.config[key] for key in _MOVES if key in base.config})
    # The road of the last reset counts, even if the configuration has changed since.
    if base.road is not None:
        whole["lanes_count"] = len(base.road.network.lanes_list())
    speeds = getattr(base.action_type, "target_speeds", None)
    if speeds is not None:
        whole["action"] = {**whole["action"], "target_speeds": speeds}
    return _scenario(env_id, kind, whole, observes)


def _scenario(env_id: str, kind: type[HighwayEnv], whole: dict[str, Any], observes: bool) -> Scenario:
    """The scenario of a class and all of its configuration."""
    installed = version("highway-env")
    if not installed.startswith(f"{COPIED}."):
        raise PlatformError(f"the compiled highway is a copy of highway-env {COPIED}; {installed} is installed")
    if not observes:
        whole["observation"] = {"type": "Kinematics"}
    refused = unsupported_highway_settings(whole)
    if refused:
        raise ConfigError(
            f"the compiled simulator cannot run {env_id} with {'; '.join(refused)}. It runs highway-v0 and "
            "highway-fast-v0 with Kinematics or OccupancyGrid, DiscreteMetaAction or ContinuousAction, and IDM, "
            "Linear, Aggressive or Defensive vehicles; take highway-env itself for the rest"
        )
    rules, inputs, action_space = _rules(kind, whole)
    view, observation_space = _view(whole)
    return Scenario(env_id, whole, rules, view, inputs, observation_space, action_space, rules.numbers[1], observes)


def _class_of(env_id: str) -> tuple[type[HighwayEnv], Mapping[str, Any]]:
    """The class of an environment id, and the configuration that it is registered with.

    Raises
    ------
    ConfigError
        If the id does not exist, or is not a plain registration of the highway.
    """
    try:
        spec = spec_of(env_id)
    except (gym.error.Error, ImportError) as error:
        raise ConfigError(f"there is no environment {env_id!r}: {error}") from None
    entry: Any = spec.entry_point
    kind: Any = gym.envs.registration.load_env_creator(entry) if isinstance(entry, str) else entry
    if kind not in (HighwayEnv, HighwayEnvFast):
        raise ConfigError(f"the compiled simulator runs highway-v0 and highway-fast-v0, not {env_id}")
    others = sorted(spec.kwargs.keys() - {"config", "render_mode"})
    if others or spec.max_episode_steps is not None or spec.additional_wrappers:
        raise ConfigError(f"{env_id} is registered with {', '.join(others) or 'wrappers'}; take highway-env itself")
    found: type[HighwayEnv] = kind
    return found, spec.kwargs.get("config") or {}


def lanes_of(count: int) -> FloatArray:
    """The lanes of highway-env's straight road, (count, LANE_COLUMNS)."""
    lanes = np.zeros((count, LANE_COLUMNS))
    lanes[:] = 0.0, AbstractLane.DEFAULT_WIDTH, 10_000.0, 30.0
    lanes[:, 0] = np.arange(count) * AbstractLane.DEFAULT_WIDTH
    return lanes


def _rules(kind: type[HighwayEnv], config: Mapping[str, Any]) -> tuple[Rules, ActionScaling | None, gym.Space[Any]]:
    """The constants for the kernels, the conversion of continuous actions (or None), and the action space."""
    traffic = utils.class_from_path(config["other_vehicles_type"])
    action, n = config["action"], config["lanes_count"]
    inputs, labels, speeds = _actions(action)
    ego = constants_of(MDPVehicle if inputs is None else Vehicle)
    if inputs is not None and action.get("speed_range"):
        ego[4], ego[3] = action["speed_range"]
    first = config["initial_lane_id"]
    frames = int(config["simulation_frequency"] // config["policy_frequency"])
    mix = mix_of(traffic)
    kinds = EGO if inputs is None else CONTINUOUS, kind_of(traffic)
    slow, fast = (float(v) for v in config["reward_speed_range"])
    rules = Rules(
        lanes=lanes_of(n),
        numbers=(
            frames,
            1 + int(config["vehicles_count"]),
            -1 if first is None else int(first) % n,
            int(kind is not HighwayEnvFast),
            *kinds,
        ),
        times=(1 / config["simulation_frequency"], 1 / config["policy_frequency"], float(config["duration"])),
        spacings=(float(config["ego_spacing"]), 1 / config["vehicles_density"], float(np.exp(-5 / 40 * n))),
        constants=np.array([ego, *map(constants_of, mix)]),
        ranges=ranges_of(mix[0]),
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


def _actions(action: Mapping[str, Any]) -> tuple[ActionScaling | None, Any, FloatArray]:
    """The conversion of continuous actions (or None), the labels of meta-actions, and the target speeds [m/s]."""
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
        return ActionScaling(*ranges, clip=action.get("clip", True)), np.zeros(0, np.int64), speeds
    kind = DiscreteMetaAction
    names = kind.ACTIONS_ALL if along and across else kind.ACTIONS_LONGI if along else kind.ACTIONS_LAT
    return None, np.array([ACTIONS.index(names[i]) for i in sorted(names)], dtype=np.int64), speeds


def _view(config: Mapping[str, Any]) -> tuple[ObservationConfig, gym.spaces.Box]:
    """The configuration of the observation for the kernels, and the observation space."""
    observation, n = config["observation"], config["lanes_count"]
    is_grid = observation["type"] == "OccupancyGrid"
    default = OccupancyGridObservation.FEATURES if is_grid else KinematicObservation.FEATURES
    features = list(observation.get("features") or default)
    ranges = observation.get("features_range")
    if not ranges:
        far, fast, side = 5.0 * Vehicle.MAX_SPEED, 2 * Vehicle.MAX_SPEED, AbstractLane.DEFAULT_WIDTH * n
        ranges = {"vx": [-fast, fast], "vy": [-fast, fast]}
        if not is_grid:
            ranges |= {"x": [-far, far], "y": [-side, side]}
    nothing = (math.nan, math.nan)
    table, places = (
        np.array([ranges.get(name, nothing)[:2] for name in names], dtype=np.float64)
        for names in (features, ("x", "y"))
    )
    switches = (
        bool(observation.get("absolute", False)),
        bool(observation.get("normalize", True)),
        bool(observation.get("clip", True)),
        bool(observation.get("see_behind", False)),
        observation.get("order", "sorted") == "shuffled",
        bool(observation.get("include_obstacles", True)),
    )
    cells = np.zeros((0, 3))
    shape: tuple[int, ...] = (int(observation.get("vehicles_count", 5)), len(features))
    if is_grid:
        size = np.array(observation.get("grid_size") or OccupancyGridObservation.GRID_SIZE)
        step = np.array(observation.get("grid_step") or OccupancyGridObservation.GRID_STEP)
        counts = np.floor((size[:, 1] - size[:, 0]) / step)
        cells = np.stack([size[:, 0], step, counts], axis=1).astype(np.float64)
        shape = (len(features), *counts.astype(int).tolist())
    names = (*FEATURES, *LAYERS)
    view = ObservationConfig(
        np.array([names.index(name) for name in features], dtype=np.int64), table, switches, places, cells
    )
    return view, gym.spaces.Box(-np.inf, np.inf, shape, np.float32)
