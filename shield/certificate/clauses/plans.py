"""What is judged: paths, and the lanes that they commit to and stop in."""

from __future__ import annotations

from typing import Any, NamedTuple

__all__ = ["Plans"]


class Plans(NamedTuple):
    """Paths (n, K, 4), and the lane that each commits to, and stops in, (n,)."""

    paths: Any
    lanes: Any
    fails: Any
