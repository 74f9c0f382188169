"""Which of highway-env's environments have traffic on a network that follows from its state alone."""

from __future__ import annotations

from typing import Any

from highway_env.envs.exit_env import ExitEnv
from highway_env.envs.highway_env import HighwayEnv
from highway_env.envs.merge_env import MergeEnv
from highway_env.envs.roundabout_env import RoundaboutEnv
from highway_env.envs.two_way_env import TwoWayEnv
from highway_env.envs.u_turn_env import UTurnEnv

from dynamics.errors import ConfigError

__all__ = ["check_network", "on_network"]

_KNOWN = (ExitEnv, MergeEnv, RoundaboutEnv, TwoWayEnv, UTurnEnv)
"""Nothing is drawn after their reset, and nobody appears or vanishes."""


def on_network(base: Any) -> bool:
    """Whether an environment, unwrapped, has another road than a straight highway."""
    return isinstance(base, ExitEnv) or not isinstance(base, HighwayEnv)


def check_network(base: Any) -> None:
    """Raise where the traffic of an environment, unwrapped, is not known.

    Raises
    ------
    ConfigError
        That lists the classes that are.
    """
    if not isinstance(base, _KNOWN):
        known = ", ".join(kind.__name__ for kind in _KNOWN)
        raise ConfigError(
            f"the traffic of {type(base).__name__} does not follow from its state; it does on straight highways "
            f"(highway-v0, highway-fast-v0) and in {known}"
        )
    for kind in type(base).__mro__[: next(k for k, each in enumerate(type(base).__mro__) if each in _KNOWN)]:
        if "step" in vars(kind) or "_simulate" in vars(kind):
            raise ConfigError(f"{kind.__name__} steps in a way of its own")
