"""Throttle and steering on a grid, each with a number of values of its own."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from itertools import product
from types import MethodType
from typing import Any

import numpy as np
from gymnasium import spaces
from highway_env.envs.common.action import ActionType, ContinuousAction, DiscreteAction, action_factory

from dynamics.errors import ConfigError
from dynamics.state import FloatArray

__all__ = ["KEPT", "ActionGrid", "define_on_grid", "has_grid", "make_action_type", "put_on_grid", "read_grid"]

KEPT = ("acceleration_range", "steering_range", "speed_range", "dynamical", "clip")
"""Options of an environment's own `ContinuousAction` that a grid in its place keeps."""
_MOST = 99
"""Values of throttle, and of steering, at most: beyond them actions are as good as continuous."""


class ActionGrid(DiscreteAction):  # type: ignore[misc]
    """highway-env's `DiscreteAction` with as many values of throttle and of steering as one likes.

    Action i is the i-th pair of throttle and steering, the steering changing faster; both from -1 to 1 in even steps,
    as highway-env's continuous actions are.

    Parameters
    ----------
    env : the environment.
    counts : how many values of throttle and of steering there are, two or more of each.
    config : what `DiscreteAction` takes but `actions_per_axis`.

    Raises
    ------
    ConfigError
        If `counts` is anything else, or throttle or steering is switched off.
    """

    def __init__(self, env: Any, counts: Any, **config: Any) -> None:
        _check_counts(counts)
        super().__init__(env, **config)
        if self.size != 2:
            raise ConfigError("actions_per_axis of two needs both longitudinal and lateral to be true")
        throttle, steering = (np.linspace(-1.0, 1.0, int(n)) for n in counts)
        self.inputs: FloatArray = np.array(list(product(throttle, steering)))
        """Normalised throttle and steering of each action, shape (actions, 2)."""

    def space(self) -> spaces.Discrete:
        """One number for each pair."""
        return spaces.Discrete(len(self.inputs))

    def act(self, action: int) -> None:
        """Act on the ego."""
        ContinuousAction.act(self, self.inputs[int(action)])


def read_grid(text: str) -> list[int]:
    """The numbers of values of throttle and of steering in a text such as "5x9".

    Raises
    ------
    ConfigError
        If it is anything else, or a number makes no grid.

    Examples
    --------
    >>> read_grid("5x9")
    [5, 9]
    """
    found = re.fullmatch(r"(\d+)[x×](\d+)", text.strip())
    if found is None:
        raise ConfigError(f"a grid of actions is NxM, values of throttle and of steering, such as 5x9; not {text!r}")
    counts = [int(each) for each in found.groups()]
    _check_counts(counts)
    return counts


def has_grid(config: Mapping[str, Any]) -> bool:
    """Whether a configuration asks for a grid: a `DiscreteAction` with two `actions_per_axis`."""
    action = config.get("action")
    if not isinstance(action, Mapping) or action.get("type") != "DiscreteAction":
        return False
    return isinstance(action.get("actions_per_axis"), list | tuple)


def define_on_grid(env: Any, define: Callable[[], None]) -> None:
    """Define an environment's spaces, with the grid of actions that its configuration asks for.

    Parameters
    ----------
    env : the environment, unwrapped. define : defines its spaces, of an action type of highway-env's.
    """
    asked = env.config["action"]
    rest = {key: value for key, value in asked.items() if key not in ("type", "actions_per_axis")}
    env.config["action"] = {"type": "ContinuousAction", **rest}
    try:
        define()
    finally:
        env.config["action"] = asked
    env.action_type = ActionGrid(env, asked["actions_per_axis"], **rest)
    env.action_space = env.action_type.space()


def put_on_grid(env: Any, action: Mapping[str, Any]) -> None:
    """Give an environment that was made with `ContinuousAction` a grid of actions, now and after each reset.

    Parameters
    ----------
    env : of highway-env, unwrapped. action : its configuration, as of `has_grid`.
    """
    env.config["action"] = dict(action)
    # A bound method, which a deep copy of the environment binds to the copy.
    env.define_spaces = MethodType(_define_spaces, env)
    env.define_spaces()


def _define_spaces(env: Any) -> None:
    define_on_grid(env, MethodType(type(env).define_spaces, env))


def _check_counts(counts: Any) -> None:
    whole = all(isinstance(n, int | np.integer) and not isinstance(n, bool) and 2 <= n <= _MOST for n in counts)
    if len(counts) != 2 or not whole:
        raise ConfigError(
            f"actions_per_axis is a whole number, or two from 2 to {_MOST} (throttle, steering), not {list(counts)}"
        )


def make_action_type(env: Any, config: Mapping[str, Any]) -> ActionType:
    """The action type of a configuration: highway-env's, or an `ActionGrid` for a `DiscreteAction` with two
    `actions_per_axis`."""
    counts = config.get("actions_per_axis")
    if config.get("type") != "DiscreteAction" or not isinstance(counts, list | tuple):
        return action_factory(env, dict(config))
    rest = {key: value for key, value in config.items() if key not in ("type", "actions_per_axis")}
    return ActionGrid(env, counts, **rest)
