"""Choice between highway-env and its compiled copy, for driving and training."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import gymnasium as gym

from dynamics.road_networks.simulation.compiled_frames import CompiledFrames
from evaluation.names import SIMULATORS, check_name
from shield.errors import ConfigError, PlatformError, SceneError

__all__ = ["compiled_if_supported", "with_compiled_frames"]

T = TypeVar("T")


def compiled_if_supported(simulator: str, make: Callable[[], tuple[T, bool]]) -> T | None:
    """The compiled object of `make`; None if highway-env itself is to be used.

    Parameters
    ----------
    simulator : one of `SIMULATORS`.
    make : returns the compiled object, and whether it is exact on this machine; it raises an error if the copy does not
        support the task.

    Raises
    ------
    ConfigError
        If the simulator is unknown, or "compiled" is required and not supported.
    PlatformError
        If "compiled" is required, and not possible on this machine.
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
    """An environment on a road network, reset, with compiled frames.

    Raises
    ------
    ConfigError
        If its traffic or its actions are not supported.
    PlatformError
        If numpy's own loops are not accessible on this machine.
    """
    compiled = CompiledFrames(env)
    try:
        compiled.reset(seed=0)
    except SceneError as error:
        raise ConfigError(str(error)) from None
    return compiled
