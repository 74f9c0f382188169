"""Path of the manifest of a policy file."""

from __future__ import annotations

from pathlib import Path

__all__ = ["manifest_path"]


def manifest_path(policy: Path) -> Path:
    """Path of the manifest of a policy file: beside it, with the suffix `.json`."""
    return policy.with_suffix(".json")
