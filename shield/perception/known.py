"""What is known of an environment that is out of reach: fixed before it begins, and nothing of its traffic."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.wrappers import FrameStackObservation
from highway_env.envs.common.action import DiscreteMetaAction
from highway_env.vehicle.controller import MDPVehicle

from dynamics.roads.straight import StraightRoad
from shield.errors import ConfigError
from shield.perception.spec import ObservationSpec
from shield.perception.undoing import check_wrappers

__all__ = ["Known"]

_NEEDED = ("observation", "action", "lanes_count", "simulation_frequency", "policy_frequency", "duration")
_HIGHWAYS = ("HighwayEnv", "HighwayEnvFast")
_LONG = 1e5
"""An episode of more decisions than this is taken to last for ever."""
_SENSOR, _DELAY = "sensor_noise", "sensor_delay"


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What a shield has to know beforehand to work from observations alone.

    Attributes
    ----------
    spec : what the observations mean.
    road : the static road map; its lanes lie along x.
    dt : duration of a simulation frame [s]. frames : simulation frames in a decision.
    decisions : after so many decisions an episode is over at the latest; 0 where that is not known.
    target_speeds : the speeds that FASTER and SLOWER choose from [m/s]. actions : label of each meta-action, by index.
    stacked : how many observations a wrapper of the environment shows at once, the latest of them last.
    noise : what the sensor says of its own noise, standard deviations of x, y [m], vx, vy [m/s]; None where it says
        nothing. delay : for how many frames what it shows of the others is out of date.

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

    spec: ObservationSpec
    road: StraightRoad
    dt: float
    frames: int
    decisions: int = 0
    target_speeds: tuple[float, ...] = tuple(map(float, MDPVehicle.DEFAULT_TARGET_SPEEDS))
    actions: tuple[str, ...] = tuple(DiscreteMetaAction.ACTIONS_ALL.values())
    stacked: int = 1
    noise: tuple[float, float, float, float] | None = None
    delay: int = 0

    def __post_init__(self) -> None:
        if not self.dt > 0 or self.frames < 1 or self.stacked < 1 or self.decisions < 0 or self.delay < 0:
            raise ConfigError(
                "dt, frames and stacked are above 0, decisions and delay from 0 on, got "
                f"{self.dt}, {self.frames}, {self.stacked}, {self.decisions} and {self.delay}"
            )
        if self.road.heading:
            raise ConfigError("observations are read on roads along x only")
        if len(self.target_speeds) < 2 or not np.all(np.diff(self.target_speeds) > 0):
            raise ConfigError(f"target speeds ascend, and there are at least two, got {self.target_speeds}")

    @classmethod
    def from_config(cls, config: Mapping[str, Any], stacked: int = 1) -> Known:
        """What highway-env's configuration of a straight highway says (`highway-v0`, `highway-fast-v0`).

        Parameters
        ----------
        config : all of it, such as `env.unwrapped.config`, or `HighwayEnvFast.default_config()` with changes.
        stacked : how many observations a wrapper of the environment shows at once.

        Raises
        ------
        ConfigError
            If something is missing, or it has other actions than meta-actions, or observations that cannot be read.
        """
        missing = [name for name in _NEEDED if name not in config]
        if missing:
            raise ConfigError(
                f"the configuration lacks {', '.join(missing)}: pass all of it, such as env.unwrapped.config, or "
                "HighwayEnvFast.default_config() with your changes"
            )
        action, lanes = dict(config["action"]), int(config["lanes_count"])
        if action.get("type") != DiscreteMetaAction.__name__:
            raise ConfigError(f"observations are read for DiscreteMetaAction, not {action.get('type')!r}")
        if int(config.get("controlled_vehicles", 1)) != 1:
            raise ConfigError(f"observations are read for one ego, not {config['controlled_vehicles']}")
        fast, rate = config["simulation_frequency"], config["policy_frequency"]
        speeds = action.get("target_speeds")
        return cls(
            spec=ObservationSpec.from_config(config["observation"], lanes),
            road=StraightRoad.from_lanes(lanes),
            dt=1 / fast,
            frames=int(fast // rate),
            decisions=_decisions(float(config["duration"]), float(rate)),
            target_speeds=tuple(map(float, MDPVehicle.DEFAULT_TARGET_SPEEDS if speeds is None else speeds)),
            actions=_labels(action),
            stacked=stacked,
        )

    @classmethod
    def of(cls, env: Any) -> tuple[Known, ...]:
        """Of each environment of a VecEnv, whatever processes they are in.

        They are asked for their configuration, for what they were made of (`spec`), and where there is a sensor, for
        what it says of itself; never for their state.

        Raises
        ------
        ConfigError
            If one is not `highway-v0` or `highway-fast-v0` as `gym.make` makes them, is shielded already, or has a
            wrapper that changes what is observed and cannot be undone.
        """
        check_wrappers(env, ())
        specs, configs = env.get_attr("spec"), env.get_attr("config")
        found = []
        for i, (spec, config) in enumerate(zip(specs, configs, strict=True)):
            wrappers = _wrappers(spec)
            sensors = [kind for kind in wrappers if hasattr(kind, _SENSOR)]
            shown = [kind for kind in wrappers if kind not in sensors and _observes(kind)]
            check_wrappers(None, tuple(kind.__name__ for kind in shown))
            one = cls.from_config(config, _stacked(spec))
            found.append(one if not sensors else _with_sensor(one, env, i))
        return tuple(found)

    @property
    def shape(self) -> tuple[int, ...]:
        """Of what the environment shows, with what is stacked."""
        return self.spec.shape if self.stacked == 1 else (self.stacked, *self.spec.shape)


def _decisions(duration: float, rate: float) -> int:
    """How many decisions there are until highway-env's clock, a sum of their durations, is there."""
    if not duration * rate < _LONG:
        return 0
    time, many = 0.0, 0
    while time < duration:
        time, many = time + 1 / rate, many + 1
    return many


def _labels(action: Mapping[str, Any]) -> tuple[str, ...]:
    along, across = bool(action.get("longitudinal", True)), bool(action.get("lateral", True))
    kinds = DiscreteMetaAction
    chosen = kinds.ACTIONS_ALL if along and across else kinds.ACTIONS_LONGI if along else kinds.ACTIONS_LAT
    return tuple(chosen.values())


def _wrappers(spec: Any) -> list[type]:
    """Classes of the wrappers around an environment, innermost first."""
    entry = getattr(spec, "entry_point", None)
    module, _, name = entry.partition(":") if isinstance(entry, str) else ("", "", "")
    if not module.startswith("highway_env.envs") or name not in _HIGHWAYS:
        raise ConfigError(
            f"the road of {entry or 'an environment that gym.make has not made'} is not known beforehand: have "
            "highway-v0 and highway-fast-v0, or pass Shield(..., known=Known(...)) with its road map"
        )
    found = [_class(each.entry_point) for each in spec.additional_wrappers]
    if any(kind.__name__ == "ShieldedEnv" for kind in found):
        raise ConfigError("this environment is a ShieldedEnv already: a Shield around it would filter what was filtered")
    return found


def _class(entry: str) -> type:
    """A class by its entry point.

    Raises
    ------
    ConfigError
        If it cannot be imported here.
    """
    module, _, name = entry.partition(":")
    try:
        kind = getattr(import_module(module), name)
    except (ImportError, AttributeError):
        raise ConfigError(
            f"nobody knows what {entry}, around an environment in another process, does to what is observed: it cannot "
            "be imported here. Pass Shield(..., known=Known(...))"
        ) from None
    assert isinstance(kind, type)
    return kind


def _observes(kind: type) -> bool:
    return issubclass(kind, gym.ObservationWrapper | FrameStackObservation)


def _stacked(spec: Any) -> int:
    many = 1
    for each in spec.additional_wrappers:
        if issubclass(_class(each.entry_point), FrameStackObservation):
            many *= int(each.kwargs["stack_size"])
    return many


def _with_sensor(known: Known, env: Any, i: int) -> Known:
    """The same with what a sensor says of itself.

    Raises
    ------
    ConfigError
        If it says nothing yet.
    """
    noise, delay = (np.asarray(env.get_attr(name, i)[0], float) for name in (_SENSOR, _DELAY))
    if noise.shape != (4,) or not noise.any():
        raise ConfigError("the sensor does not say yet how noisy it is: reset the environments before they are shielded")
    # What is noisy may be beyond the range that it was clipped to.
    spec = replace(known.spec, clip=False)
    x, y, vx, vy = noise.tolist()
    return replace(known, spec=spec, noise=(x, y, vx, vy), delay=int(delay))
