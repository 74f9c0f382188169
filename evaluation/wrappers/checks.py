"""Checks of the user's environments and numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.scenes.scene import has_road_and_vehicles
from shield.errors import ConfigError

__all__ = ["check_highway_env", "check_number"]


def check_highway_env(env: Any, wrapper: str) -> None:
    """Raise a `ConfigError` unless the environment has highway-env's road and vehicles."""
    base = getattr(env, "unwrapped", env)
    if not has_road_and_vehicles(base):
        raise ConfigError(
            f"{wrapper} is for highway-env's environments, and those made as they are; {type(base).__name__} has no "
            "road and vehicles"
        )


def check_number(name: str, value: Any, least: float = -np.inf, above: float = -np.inf) -> None:
    """Raise a `ConfigError` unless the value is a finite number, at least `least` and more than `above`.

    Examples
    --------
    >>> check_number("penalty", -1.0, least=0.0)
    Traceback (most recent call last):
    ...
    dynamics.errors.ConfigError: penalty is a finite number from 0 on, not -1.0
    """
    number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    if number and np.isfinite(value) and value >= least and value > above:
        return
    range_ = f" from {least:g} on" if np.isfinite(least) else f" above {above:g}" if np.isfinite(above) else ""
    raise ConfigError(f"{name} is a finite number{range_}, not {value!r}")
