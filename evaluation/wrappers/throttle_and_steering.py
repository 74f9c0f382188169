"""Throttle and steering on roads whose rewards highway-env computes for meta-actions only.

The environments are registered with Gymnasium too: `merge-continuous-v1`, `roundabout-continuous-v1`,
`two-way-continuous-v0`, `u-turn-continuous-v1` and the others, with highway-env's configuration. If highway-env sets no
limit, an episode ends after 60 decisions. With meta-actions the ego always reaches the end of the road, but with
throttle and steering it may not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
from gymnasium.envs.registration import load_env_creator
from gymnasium.utils import RecordConstructorArgs
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.dynamics import BicycleVehicle
from highway_env.vehicle.kinematics import Vehicle

from dynamics.vehicle.action_grid import define_on_grid, has_grid
from evaluation.continuous_roads import ROADS, continuous_id
from shield.errors import ConfigError

__all__ = ["ROADS", "ThrottleAndSteering", "make_continuous"]

_IDLE = 1
_LIMIT = 60


class ThrottleAndSteering(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """An environment with meta-actions, driven by throttle and steering (`ContinuousAction`) instead.

    highway-env 1.12 raises an error for this configuration of merge, roundabout, two-way or u-turn, already in
    `gym.make`. Their rewards and observations read the meta-action, or the vehicle's target speed. This wrapper
    provides them: the meta-action is IDLE, without a reward for lane changes; the target speed is the nearest one to
    the speed; and the target lane is the vehicle's lane. Everything else is highway-env's.

    Parameters
    ----------
    env : an environment of highway-env, with meta-actions.
    action : options of `ContinuousAction`, such as `acceleration_range`, `lateral` or `dynamical`; with
        `actions_per_axis`, one or two numbers, those of `DiscreteAction`.

    Raises
    ------
    ConfigError
        If it is no environment of highway-env, or has throttle and steering already.

    Examples
    --------
    >>> import gymnasium as gym, highway_env
    >>> env = ThrottleAndSteering(gym.make("roundabout-v1"))
    >>> obs, info = env.reset(seed=0)
    >>> env.action_space.shape
    (2,)
    """

    def __init__(self, env: gym.Env[Any, Any], **action: Any) -> None:
        RecordConstructorArgs.__init__(self, **action)
        gym.Wrapper.__init__(self, env)
        base: Any = env.unwrapped
        kind = getattr(base, "config", {}).get("action", {}).get("type")
        if kind != "DiscreteMetaAction":
            raise ConfigError(
                f"ThrottleAndSteering takes an environment of highway-env with DiscreteMetaAction; "
                f"{type(base).__name__} has {kind or 'no actions of highway-env'}"
            )
        speeds = base.config["action"].get("target_speeds")
        self._speeds = np.array(MDPVehicle.DEFAULT_TARGET_SPEEDS if speeds is None else speeds, float)
        rewards, define_spaces = base._rewards, base.define_spaces

        def define() -> None:
            with self._with_controllers():
                if has_grid(base.config):
                    define_on_grid(base, define_spaces)
                else:
                    define_spaces()
            observe = base.observation_type.observe
            base.observation_type.observe = lambda: self._answer(observe)

        base._rewards = lambda action: self._answer(self._paid, rewards)
        base.define_spaces = define
        kind = "DiscreteAction" if "actions_per_axis" in action else "ContinuousAction"
        base.config["action"] = {"type": kind, **action}
        base.reset()

    def _answer(self, question: Callable[..., Any], *arguments: Any) -> Any:
        with self._with_controllers():
            return question(*arguments)

    def _paid(self, rewards: Callable[[int], dict[str, float]]) -> dict[str, float]:
        try:
            return rewards(_IDLE)
        except ZeroDivisionError:
            # `TwoWayEnv` divides by the number of lanes beside the vehicle's, which is 0 after a turn back.
            vehicle: Any = self.unwrapped.vehicle  # type: ignore[attr-defined]
            return {"high_speed_reward": vehicle.speed_index / (len(self._speeds) - 1), "left_lane_reward": 0.0}

    @contextmanager
    def _with_controllers(self) -> Iterator[None]:
        """Give the vehicle the attributes of one with meta-actions for the duration of the context."""
        vehicle, n = self.unwrapped.vehicle, len(self._speeds)  # type: ignore[attr-defined]
        if type(vehicle) not in (Vehicle, BicycleVehicle):
            yield
            return
        share = (vehicle.speed - self._speeds[0]) / (self._speeds[-1] - self._speeds[0])
        added: dict[str, Any] = {
            "speed_index": int(np.clip(np.round(share * (n - 1)), 0, n - 1)),
            "index_to_speed": self._speeds.__getitem__,
            "route": None,
            "target_speeds": self._speeds,
            "target_lane_index": vehicle.lane_index,
        }
        vars(vehicle).update(added)
        try:
            yield
        finally:
            for name in added:
                del vars(vehicle)[name]


def make_continuous(road: str, config: Mapping[str, Any] | None = None, render_mode: str | None = None) -> Any:
    """Make one of `ROADS` with throttle and steering.

    Parameters
    ----------
    road : id of the environment.
    config : highway-env's configuration; its action, if there is one, is a `ContinuousAction` or a `DiscreteAction`.
    render_mode : as in highway-env.

    Raises
    ------
    ConfigError
        If the action is of another type.
    """
    own = dict(config or {})
    action = dict(own.pop("action", {}))
    kind = action.pop("type", "ContinuousAction")
    if kind == "DiscreteAction":
        action.setdefault("actions_per_axis", 3)
    elif kind != "ContinuousAction":
        raise ConfigError(
            f"{road} has its other actions in highway-env itself; here it has ContinuousAction or DiscreteAction"
        )
    creator = load_env_creator(str(gym.spec(road).entry_point))
    env: Any = creator(config=own or None, render_mode=render_mode)
    return ThrottleAndSteering(env, **action)


def _register() -> None:
    for road in ROADS:
        gym.register(
            id=continuous_id(road),
            entry_point=f"{__name__}:make_continuous",
            max_episode_steps=gym.spec(road).max_episode_steps or _LIMIT,
            kwargs={"road": road},
        )


_register()
