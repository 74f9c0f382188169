"""Environments in slices, one thread for each slice."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

__all__ = ["Slices", "consecutive"]


class Slices:
    """Divides `count` environments into consecutive slices of nearly equal size, one for each of at most `threads`
    threads.

    Attributes
    ----------
    bounds : the first environment of each slice, and the one after its last.
    """

    def __init__(self, count: int, threads: int) -> None:
        ends = np.linspace(0, count, min(threads, count) + 1).round().astype(int).tolist()
        self.bounds: list[tuple[int, int]] = list(pairwise(ends))
        self._pool = ThreadPoolExecutor(len(self.bounds)) if len(self.bounds) > 1 else None

    def run(self, part: Callable[[int, int, int], None], which: NDArray[np.int64] | None = None) -> None:
        """Call `part` with the number of each slice and its bounds, all slices in parallel.

        Parameters
        ----------
        part : called as part(slice, first, last + 1).
        which : environments, in increasing order; `part` is called for each range of consecutive ones within a slice.
            By default all.
        """
        ranges = None if which is None else consecutive(which)

        def run_slice(k: int) -> None:
            start, end = self.bounds[k]
            if ranges is None:
                part(k, start, end)
                return
            for first, last in ranges:
                if max(first, start) < min(last, end):
                    part(k, max(first, start), min(last, end))

        if self._pool is None:
            run_slice(0)
        else:
            list(self._pool.map(run_slice, range(len(self.bounds))))


def consecutive(which: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Ranges (first, last + 1) of consecutive numbers in an increasing sequence.

    Examples
    --------
    >>> consecutive(np.array([0, 1, 4]))
    [(0, 2), (4, 5)]
    """
    if not len(which):
        return []
    breaks = np.flatnonzero(np.diff(which) != 1)
    firsts, lasts = [which[0], *which[breaks + 1]], [*which[breaks], which[-1]]
    return [(int(first), int(last) + 1) for first, last in zip(firsts, lasts, strict=True)]
