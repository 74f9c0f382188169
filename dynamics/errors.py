"""The error hierarchy of the project: one root, messages that list what would have been valid."""

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
    "perhaps",
]


_NEAR = 0.7
"""How alike two names are that one may be meant for the other, of 1 (see `difflib.SequenceMatcher.ratio`)."""


def perhaps(name: object, valid: Iterable[str]) -> str:
    """What is added to a message about an unknown name: the valid name nearest to it, or nothing if none is near.

    Examples
    --------
    >>> perhaps("highway-fats", ["highway-fast", "merge"]), perhaps("boat", ["merge"])
    ("; perhaps 'highway-fast' is meant", '')
    """
    near = get_close_matches(str(name), list(valid), 1, cutoff=_NEAR)
    return f"; perhaps {near[0]!r} is meant" if near else ""


class ShieldError(Exception):
    """Root of every error that this project raises on purpose."""


class ConfigError(ShieldError, ValueError):
    """A setting, option or name is not one of the valid ones."""


class MissingAttributeError(ConfigError, AttributeError):
    """An attribute or a method that an object has not is asked of it by name; to `hasattr` it is not there."""


class SceneError(ShieldError, ValueError):
    """An environment or a state cannot be read as a scene (wrong shape, NaN, unsupported road)."""


class ActionError(ShieldError, ValueError):
    """An action is outside the action space."""


class DataError(ShieldError, ValueError):
    """Recorded data are empty, of the wrong shape, not finite, or in a file that cannot be read."""


class ModelError(ShieldError, ValueError):
    """A dynamics model is given arrays that it cannot use, or a file that it cannot be read from."""


class PolicyError(ShieldError, TypeError):
    """An object handed in as a policy cannot be used as one."""


class PlatformError(ShieldError, RuntimeError):
    """This machine, or a library on it, is not as something exact needs it."""
