"""The error hierarchy of the project: one root, messages that list what would have been valid."""

from __future__ import annotations

__all__ = ["ActionError", "ConfigError", "PolicyError", "SceneError", "ShieldError"]


class ShieldError(Exception):
    """Root of every error that this project raises on purpose."""


class ConfigError(ShieldError, ValueError):
    """A setting, option or name is not one of the valid ones."""


class SceneError(ShieldError, ValueError):
    """An environment or a state cannot be read as a scene (wrong shape, NaN, unsupported road)."""


class ActionError(ShieldError, ValueError):
    """An action is outside the action space."""


class PolicyError(ShieldError, TypeError):
    """An object handed in as a policy cannot be used as one."""
