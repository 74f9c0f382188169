"""Errors raised by the shield (defined at the lowest layer, so that every layer can raise them)."""

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
