"""The choice between highway-env and its compiled copy, for whoever drives or trains in one of the two."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import gymnasium as gym

from dynamics.road_networks.simulation.compiled_frames import CompiledFrames
from evaluation.names import SIMULATORS, check_name
from shield.errors import ConfigError, PlatformError, SceneError

__all__ = ["compiled_where_it_serves", "with_compiled_frames"]

T = TypeVar("T")


def compiled_where_it_serves(simulator: str, make: Callable[[], tuple[T, bool]]) -> T | None:
    """What `make` makes of the compiled copy; None where highway-env itself is to be taken.

    Parameters
    ----------
    simulator : one of `SIMULATORS`.
    make : makes it, and says whether it is exact here; it raises where the copy cannot do what is asked for.

    Raises
    ------
    ConfigError
        If there is no such simulator, or the compiled one is asked for and cannot do it.
    PlatformError
        If it is asked for, and cannot be had on this machine.
    """
    check_name("simulator", simulator, SIMULATORS)
    if simulator == "highway-env":
        return None
    try:
        made, exact = make()
    except (ConfigError, PlatformError):
        if simulator == "compiled":
            raise
        return None
    return made if exact or simulator == "compiled" else None


def with_compiled_frames(env: gym.Env[Any, Any]) -> CompiledFrames:
    """An environment on a network of roads, reset, with its frames compiled.

    Raises
    ------
    ConfigError
        If its traffic or its actions are not known.
    PlatformError
        If numpy's own loops cannot be had here.
    """
    compiled = CompiledFrames(env)
    try:
        compiled.reset(seed=0)
    except SceneError as error:
        raise ConfigError(str(error)) from None
    return compiled
