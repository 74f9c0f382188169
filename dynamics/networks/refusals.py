"""Which of highway-env's environments have traffic on a network that follows from its state alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from highway_env.envs.exit_env import ExitEnv
from highway_env.envs.highway_env import HighwayEnv
from highway_env.envs.intersection_env import IntersectionEnv
from highway_env.envs.merge_env import MergeEnv
from highway_env.envs.roundabout_env import RoundaboutEnv
from highway_env.envs.two_way_env import TwoWayEnv
from highway_env.envs.u_turn_env import UTurnEnv
from highway_env.road.regulation import RegulatedRoad

from dynamics.errors import ConfigError

__all__ = ["check_network", "exits_of", "on_network", "period_of"]

_KNOWN = (ExitEnv, IntersectionEnv, MergeEnv, RoundaboutEnv, TwoWayEnv, UTurnEnv)
"""Nothing is drawn after their reset, but for who comes to an intersection."""


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


def exits_of(base: Any) -> Callable[[tuple[str, str, int]], bool] | None:
    """Which lanes vehicles vanish from near their end, by highway-env's index of them; None for nowhere."""
    if not isinstance(base, IntersectionEnv):
        return None
    return lambda key: "il" in key[0] and "o" in key[1]


def period_of(base: Any) -> int:
    """After how many frames it is settled anew who yields; 0 where nobody does.

    Raises
    ------
    ConfigError
        If those who yield do it for longer than until it is settled anew.
    """
    road = base.road
    if not isinstance(road, RegulatedRoad):
        return 0
    if road.YIELD_DURATION != 0:
        raise ConfigError(f"who yields does it for {road.YIELD_DURATION} s; known is a YIELD_DURATION of 0")
    return int(1 / (1 / base.config["simulation_frequency"]) / road.REGULATION_FREQUENCY)
