"""Actions on a grid of throttle and steering, with a separate number of values for each."""

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
"""Options of an environment's own `ContinuousAction` that are kept when a grid replaces it."""
_MOST = 99
"""Greatest number of values of throttle, and of steering."""


class ActionGrid(DiscreteAction):  # type: ignore[misc]
    """highway-env's `DiscreteAction` with separate numbers of values of throttle and of steering.

    Action i is the i-th pair of throttle and steering, the steering changing faster. Both are evenly spaced from -1 to
    1, the range of highway-env's continuous actions.

    Parameters
    ----------
    env : the environment.
    counts : number of values of throttle and of steering, two or more of each.
    config : the options of `DiscreteAction` except `actions_per_axis`.

    Raises
    ------
    ConfigError
        If `counts` is invalid, or throttle or steering is switched off.
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
        """One action number for each pair."""
        return spaces.Discrete(len(self.inputs))

    def act(self, action: int) -> None:
        """Apply an action to the ego."""
        ContinuousAction.act(self, self.inputs[int(action)])


def read_grid(text: str) -> list[int]:
    """The numbers of values of throttle and of steering in a text such as "5x9".

    Raises
    ------
    ConfigError
        If the text has another form, or a number is out of range.

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
    """Whether a configuration specifies a grid: a `DiscreteAction` with two `actions_per_axis`."""
    action = config.get("action")
    if not isinstance(action, Mapping) or action.get("type") != "DiscreteAction":
        return False
    return isinstance(action.get("actions_per_axis"), list | tuple)


def define_on_grid(env: Any, define: Callable[[], None]) -> None:
    """Define an environment's spaces, with the grid of actions of its configuration.

    Parameters
    ----------
    env : the environment, unwrapped.
    define : function that defines its spaces for an action type of highway-env.
    """
    action_config = env.config["action"]
    rest = {key: value for key, value in action_config.items() if key not in ("type", "actions_per_axis")}
    env.config["action"] = {"type": "ContinuousAction", **rest}
    try:
        define()
    finally:
        env.config["action"] = action_config
    env.action_type = ActionGrid(env, action_config["actions_per_axis"], **rest)
    env.action_space = env.action_type.space()


def put_on_grid(env: Any, action: Mapping[str, Any]) -> None:
    """Replace the `ContinuousAction` of an environment by a grid of actions, now and after each reset.

    Parameters
    ----------
    env : of highway-env, unwrapped. action : configuration of the grid, as of `has_grid`.
    """
    env.config["action"] = dict(action)
    # A bound method: a deep copy of the environment binds it to the copy.
    env.define_spaces = MethodType(_define_spaces, env)
    env.define_spaces()


def _define_spaces(env: Any) -> None:
    define_on_grid(env, MethodType(type(env).define_spaces, env))


def _check_counts(counts: Any) -> None:
    """Check two numbers of values.

    Raises
    ------
    ConfigError
        If there are not two integers from 2 to `_MOST`.
    """
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
