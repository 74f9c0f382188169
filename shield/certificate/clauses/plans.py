"""What is judged: paths, and the lanes that they commit to and stop in."""

from __future__ import annotations

from typing import NamedTuple

from dynamics.state import FloatArray, IntArray

__all__ = ["Plans"]


class Plans(NamedTuple):
    """Paths (n, K, 4), and the lane that each commits to, and stops in, (n,)."""

    paths: FloatArray
    lanes: IntArray
    fails: IntArray
