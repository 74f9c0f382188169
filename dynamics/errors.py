"""The error hierarchy of the project: one root class. Messages list the valid values."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

__all__ = [
    "ActionError",
    "ConfigError",
    "DataError",
    "MissingAttributeError",
    "ModelError",
    "PlatformError",
    "PolicyError",
    "SceneError",
    "ShieldError",
    "nearest_name_hint",
]


_NEAR = 0.7
"""Least similarity of two names from which one is suggested for the other, from 0 to 1
(`difflib.SequenceMatcher.ratio`)."""


def nearest_name_hint(name: object, valid: Iterable[str]) -> str:
    """Suggestion at the end of a message about an unknown name: the nearest valid name, or an empty text if none is
    near.

    Examples
    --------
    >>> nearest_name_hint("highway-fats", ["highway-fast", "merge"]), nearest_name_hint("boat", ["merge"])
    ("; perhaps 'highway-fast' is meant", '')
    """
    near = get_close_matches(str(name), list(valid), 1, cutoff=_NEAR)
    return f"; perhaps {near[0]!r} is meant" if near else ""


class ShieldError(Exception):
    """Root of every error that this project raises on purpose."""


class ConfigError(ShieldError, ValueError):
    """A setting, option or name is not one of the valid ones."""


class MissingAttributeError(ConfigError, AttributeError):
    """An object lacks the named attribute or method. `hasattr` returns False for it."""


class SceneError(ShieldError, ValueError):
    """An environment or a state cannot be read as a scene (wrong shape, NaN, unsupported road)."""


class ActionError(ShieldError, ValueError):
    """An action is outside the action space."""


class DataError(ShieldError, ValueError):
    """Recorded data are empty, of the wrong shape, not finite, or in a file that cannot be read."""


class ModelError(ShieldError, ValueError):
    """A dynamics model received arrays that it cannot use, or cannot be read from a file."""


class PolicyError(ShieldError, TypeError):
    """An object given as a policy cannot be used as one."""


class PlatformError(ShieldError, RuntimeError):
    """This machine, or a library on it, does not compute as an exact result requires."""
