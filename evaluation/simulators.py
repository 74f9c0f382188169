"""The choice between highway-env and its compiled copy, for whoever drives or trains in one of the two."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from evaluation.names import SIMULATORS
from shield.errors import ConfigError, PlatformError

__all__ = ["compiled_where_it_serves"]

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
    if simulator not in SIMULATORS:
        raise ConfigError(f"unknown simulator {simulator!r}; have {', '.join(SIMULATORS)}")
    if simulator == "highway-env":
        return None
    try:
        made, exact = make()
    except (ConfigError, PlatformError):
        if simulator == "compiled":
            raise
        return None
    return made if exact or simulator == "compiled" else None
