"""Errors of the shield. They are defined in the lowest package, so that every package can raise them."""

from __future__ import annotations

from dynamics.errors import (
    ActionError,
    ConfigError,
    MissingAttributeError,
    PlatformError,
    PolicyError,
    SceneError,
    ShieldError,
)

__all__ = [
    "ActionError",
    "ConfigError",
    "MissingAttributeError",
    "PlatformError",
    "PolicyError",
    "SceneError",
    "ShieldError",
]
