"""Prior map: facts about an environment in another process, fixed before an episode begins. No facts about its
traffic."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec, registry
from gymnasium.wrappers import FrameStackObservation
from highway_env.envs.common.action import DiscreteMetaAction
from highway_env.vehicle.controller import MDPVehicle
from stable_baselines3.common.vec_env import VecEnvWrapper

from dynamics.roads.straight import StraightRoad
from shield.errors import ConfigError
from shield.perception.clipping import check_ranges
from shield.perception.grid_spec import GridSpec, Spec, spec_from_config
from shield.perception.unwrapping import TRANSPARENT_WRAPPERS, check_wrappers
from shield.supported_environments import check_frequency, check_target_speeds, refuse_manual_control

__all__ = ["Known"]

_NEEDED = ("observation", "action", "lanes_count", "simulation_frequency", "policy_frequency", "duration")
_HIGHWAYS = ("HighwayEnv", "HighwayEnvFast")
_PASSIVE = (
    "Autoreset",
    "CompiledFrames",
    "HumanRendering",
    "Monitor",
    "OrderEnforcing",
    "PassiveEnvChecker",
    "RecordEpisodeStatistics",
    "RecordVideo",
    "TimeLimit",
)
"""Wrappers that keep observations unchanged."""
_LONG = 1e5
"""An episode of more decisions than this counts as endless."""
_SENSOR, _DELAY = "sensor_noise", "sensor_delay"
_QUERY_METHODS = ("get_attr", "has_attr", "env_method", "env_is_wrapped")
"""Methods of a VecEnv by which its environments are queried."""


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """Prior map of a shield that works from observations alone.

    Attributes
    ----------
    spec : meaning of the observations, an `ObservationSpec` or a `GridSpec`.
    road : the static road map; its lanes lie along x.
    dt : duration of a simulation frame [s]. frames : simulation frames in a decision.
    decisions : greatest number of decisions in an episode; 0 if unknown.
    target_speeds : the speeds that FASTER and SLOWER choose from [m/s]. actions : label of each meta-action, by index.
    stacked : number of observations that a wrapper stacks, the latest last.
    noise : standard deviations of x, y [m], vx, vy [m/s] that the sensor states; None without a statement.
    delay : frames by which the observed vehicles are out of date.
    lane, speed : initial lane and speed [m/s] of the ego, at the centre of the lane, which a grid does not show. None
        for the lane that fits its layer `on_road`.

    Raises
    ------
    ConfigError
        If a number is out of range, or the lanes do not lie along x.

    Examples
    --------
    >>> from highway_env.envs.highway_env import HighwayEnvFast
    >>> known = Known.from_config(HighwayEnvFast.default_config())
    >>> known.road.centers.tolist(), known.frames, known.actions[3]
    ([0.0, 4.0, 8.0], 5, 'FASTER')
    """

    spec: Spec
    road: StraightRoad
    dt: float
    frames: int
    decisions: int = 0
    target_speeds: tuple[float, ...] = tuple(map(float, MDPVehicle.DEFAULT_TARGET_SPEEDS))
    actions: tuple[str, ...] = tuple(DiscreteMetaAction.ACTIONS_ALL.values())
    stacked: int = 1
    noise: tuple[float, float, float, float] | None = None
    delay: int = 0
    lane: int | None = None
    speed: float = 25.0

    def __post_init__(self) -> None:
        if not self.dt > 0 or self.frames < 1 or self.stacked < 1 or self.decisions < 0 or self.delay < 0:
            raise ConfigError(
                "dt, frames and stacked are above 0, decisions and delay from 0 on, got "
                f"{self.dt}, {self.frames}, {self.stacked}, {self.decisions} and {self.delay}"
            )
        if self.lane is not None and not 0 <= self.lane < self.road.centers.size:
            raise ConfigError(f"the ego begins in a lane from 0 to {self.road.centers.size - 1}, got {self.lane}")
        if self.road.heading:
            raise ConfigError("observations are read on roads along x only")
        # Removes the rounding error of 1 / dt.
        check_frequency(round(1 / self.dt, 9), simulated=False)
        if len(self.target_speeds) < 2 or not np.all(np.diff(self.target_speeds) > 0):
            raise ConfigError(f"target speeds ascend, and there are at least two, got {self.target_speeds}")
        check_target_speeds(self.target_speeds)
        if self.noise is None:
            centers = self.road.centers + self.road.origin[1]
            check_ranges(self.spec, (self.speed, *self.target_speeds), centers.tolist())

    @classmethod
    def from_config(cls, config: Mapping[str, Any], stacked: int = 1) -> Known:
        """Prior map from highway-env's configuration of a straight highway (`highway-v0`, `highway-fast-v0`).

        Parameters
        ----------
        config : the whole configuration, such as `env.unwrapped.config`, or `HighwayEnvFast.default_config()` with
            changes.
        stacked : number of observations that a wrapper of the environment stacks.

        Raises
        ------
        ConfigError
            If an entry is missing, the actions are not meta-actions, or the observations cannot be read.
        """
        missing = [name for name in _NEEDED if name not in config]
        if missing:
            raise ConfigError(
                f"the configuration lacks {', '.join(missing)}: pass all of it, such as env.unwrapped.config, or "
                "HighwayEnvFast.default_config() with your changes"
            )
        refuse_manual_control(config)
        action, lanes = dict(config["action"]), int(config["lanes_count"])
        if action.get("type") != DiscreteMetaAction.__name__:
            raise ConfigError(f"observations are read for DiscreteMetaAction, not {action.get('type')!r}")
        if int(config.get("controlled_vehicles", 1)) != 1:
            raise ConfigError(f"observations are read for one ego, not {config['controlled_vehicles']}")
        fast, rate = config["simulation_frequency"], config["policy_frequency"]
        speeds = action.get("target_speeds")
        return cls(
            spec=spec_from_config(config["observation"], lanes),
            road=StraightRoad.from_lanes(lanes),
            dt=1 / fast,
            frames=int(fast // rate),
            decisions=_decisions(float(config["duration"]), float(rate)),
            target_speeds=tuple(map(float, MDPVehicle.DEFAULT_TARGET_SPEEDS if speeds is None else speeds)),
            actions=_labels(action),
            stacked=stacked,
            lane=None if config.get("initial_lane_id") is None else int(config["initial_lane_id"]) % lanes,
        )

    @classmethod
    def of(cls, env: Any) -> tuple[Known, ...]:
        """Prior map of each environment of a VecEnv, in this process or in others.

        The environments are queried for their configuration, their wrappers and, where there is a sensor, its stated
        noise and delay. Their state is never queried.

        Raises
        ------
        ConfigError
            If the VecEnv lacks a method for these queries. If an environment is not `highway-v0` or `highway-fast-v0`,
            is shielded already, or has a wrapper that changes observations and cannot be undone.
        """
        check_wrappers(env, ())
        if isinstance(env, VecEnvWrapper):
            return cls.of(env.venv)
        lacking = [name for name in _QUERY_METHODS if not hasattr(env, name)]
        if lacking:
            raise ConfigError(
                f"{type(env).__name__} cannot be queried for its configuration: it lacks {', '.join(lacking)}: have a "
                "VecEnv of stable-baselines3, or pass Shield(..., known=Known(...)) with its road map"
            )
        layers, configs = _layers(env), env.get_attr("config")
        sensor = any(
            name not in _PASSIVE + TRANSPARENT_WRAPPERS for each in layers for name in each[:-1]
        ) and env.has_attr(_SENSOR)
        found = []
        for i, (names, config) in enumerate(zip(layers, configs, strict=True)):
            _check(names, sensor, any(env.env_is_wrapped(gym.ObservationWrapper, i)))
            one = cls.from_config(config)
            if FrameStackObservation.__name__ in names:
                shown = env.observation_space.shape
                one = replace(one, stacked=math.prod(shown) // math.prod(one.spec.shape))
            found.append(_with_sensor(one, env, i) if sensor else one)
        return tuple(found)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the environment's observations, stacking included."""
        return self.spec.shape if self.stacked == 1 else (self.stacked, *self.spec.shape)


def _decisions(duration: float, rate: float) -> int:
    """Number of decisions until highway-env's clock, a floating-point sum of their durations, reaches `duration` [s]; 0
    for endless."""
    if not duration * rate < _LONG:
        return 0
    time, many = 0.0, 0
    while time < duration:
        time, many = time + 1 / rate, many + 1
    return many


def _labels(action: Mapping[str, Any]) -> tuple[str, ...]:
    """Labels of the meta-actions for an action configuration."""
    along, across = bool(action.get("longitudinal", True)), bool(action.get("lateral", True))
    kinds = DiscreteMetaAction
    chosen = kinds.ACTIONS_ALL if along and across else kinds.ACTIONS_LONGI if along else kinds.ACTIONS_LAT
    return tuple(chosen.values())


def _layers(env: Any) -> list[list[str]]:
    """Names of the wrappers of each environment of a VecEnv, outermost first, and then of the environment itself."""
    spec = getattr(env, "spec", None)
    if isinstance(spec, EnvSpec):
        return [[str(spec.entry_point).rpartition(":")[2]] for _ in range(env.num_envs)]
    # The text of an environment names its wrappers. A text can be sent between processes, whatever the wrappers are.
    texts = [text.replace(">", "").removesuffix(" instance") for text in env.env_method("__str__")]
    return [[name for name in text.split("<") if name and name not in registry] for text in texts]


def _check(names: list[str], sensor: bool, observes: bool) -> None:
    """Raise `ConfigError` unless the road, and the effect of the wrappers on observations, are known beforehand.

    Parameters
    ----------
    names : see `_layers`. sensor : whether a wrapper states its noise. observes : whether a wrapper is an observation
        wrapper.
    """
    *wrappers, base = names
    if "ShieldedEnv" in wrappers:
        raise ConfigError(
            "this environment is a ShieldedEnv already: a Shield around it would filter what was filtered"
        )
    if base not in _HIGHWAYS:
        raise ConfigError(
            f"the road of {base} is not known beforehand: have {' and '.join(_HIGHWAYS)}, or pass "
            "Shield(..., known=Known(...)) with its road map"
        )
    unknown = [name for name in wrappers if name not in _PASSIVE + TRANSPARENT_WRAPPERS]
    if observes and len(unknown) > sensor:
        check_wrappers(None, tuple(unknown))


def _with_sensor(known: Known, env: Any, i: int) -> Known:
    """The prior map with the sensor's stated noise and delay.

    Raises
    ------
    ConfigError
        If the sensor does not state its noise yet.
    """
    noise, delay = (np.asarray(env.get_attr(name, i)[0], float) for name in (_SENSOR, _DELAY))
    if noise.shape != (4,) or not noise.any():
        raise ConfigError("the sensor does not state its noise yet: reset the environments before they are shielded")
    if isinstance(known.spec, GridSpec):
        raise ConfigError("a sensor that states its noise shows Kinematics, not a grid")
    x, y, vx, vy = noise.tolist()
    # A noisy value may be beyond the range that it was clipped to.
    return replace(known, spec=replace(known.spec, clip=False), noise=(x, y, vx, vy), delay=int(delay))
