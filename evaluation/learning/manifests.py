"""Where the manifest of a policy file lies."""

from __future__ import annotations

from pathlib import Path

__all__ = ["manifest_path"]


def manifest_path(policy: Path) -> Path:
    """Where the manifest of a policy file lies: beside it, as `.json`."""
    return policy.with_suffix(".json")
