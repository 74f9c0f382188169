"""Environments in slices, each of which a thread of its own steps."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np

__all__ = ["Slices"]


class Slices:
    """So many environments for so many threads, one at least.

    Attributes
    ----------
    bounds : the first environment of each slice, and the one after its last.
    """

    def __init__(self, count: int, threads: int) -> None:
        ends = np.linspace(0, count, min(threads, count) + 1).round().astype(int).tolist()
        self.bounds: list[tuple[int, int]] = list(pairwise(ends))
        self._pool = ThreadPoolExecutor(len(self.bounds)) if len(self.bounds) > 1 else None

    def run(self, part: Callable[[int, int, int], None]) -> None:
        """Call `part` with the number of each slice and its bounds, all at once."""
        if self._pool is None:
            part(0, *self.bounds[0])
        else:
            list(self._pool.map(lambda k: part(k, *self.bounds[k]), range(len(self.bounds))))
