"""Throttle and steering on a grid, each with a number of values of its own."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np
from gymnasium import spaces
from highway_env.envs.common.action import ActionType, ContinuousAction, DiscreteAction, action_factory

from dynamics.state import FloatArray
from shield.errors import ConfigError

__all__ = ["ActionGrid", "make_action_type"]


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
        whole = all(isinstance(n, int | np.integer) and not isinstance(n, bool) and n >= 2 for n in counts)
        if len(counts) != 2 or not whole:
            raise ConfigError(
                f"actions_per_axis is a whole number, or two from 2 on (throttle, steering), not {counts}"
            )
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


def make_action_type(env: Any, config: Mapping[str, Any]) -> ActionType:
    """The action type of a configuration: highway-env's, or an `ActionGrid` for a `DiscreteAction` with two
    `actions_per_axis`."""
    counts = config.get("actions_per_axis")
    if config.get("type") != "DiscreteAction" or not isinstance(counts, list | tuple):
        return action_factory(env, dict(config))
    rest = {key: value for key, value in config.items() if key not in ("type", "actions_per_axis")}
    return ActionGrid(env, counts, **rest)
