"""Monomials of several variables, computed for many points at once, points last."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Monomials"]


class Monomials:
    """All monomials of `count` variables up to a total degree, by ascending degree.

    Each monomial is one of the degree below times a variable. In the order used here, the factors for one variable are
    a single slice, so a degree costs one numpy call for each variable.

    Parameters
    ----------
    count : number of variables.
    degree : greatest total degree.
    linear : variables with a power of 0 or 1 only.

    Examples
    --------
    >>> Monomials(2, 2).exponents.tolist()
    [[0, 0], [1, 0], [0, 1], [2, 0], [1, 1], [0, 2]]
    >>> Monomials(2, 2, linear={1}).exponents.tolist()
    [[0, 0], [1, 0], [0, 1], [2, 0], [1, 1]]
    """

    def __init__(self, count: int, degree: int, linear: Collection[int] = ()) -> None:
        self.count, self.degree = count, degree
        unit = np.eye(count, dtype=int)
        table = [np.zeros(count, dtype=int)]
        self._calls: list[tuple[slice, slice, int]] = []
        shell, leads = 0, [count]
        for _ in range(degree):
            below, new_leads, start = len(table), [], len(table)
            for v in range(count):
                least = v + 1 if v in linear else v
                first = next((i for i, lead in enumerate(leads) if lead >= least), len(leads))
                parents = slice(shell + first, below)
                size = below - parents.start
                if size:
                    self._calls.append((slice(start, start + size), parents, v))
                    table += [table[i] + unit[v] for i in range(parents.start, parents.stop)]
                    new_leads += [v] * size
                    start += size
            shell, leads = below, new_leads
        self.exponents: NDArray[np.int64] = np.array(table).reshape(-1, count)

    def __len__(self) -> int:
        return len(self.exponents)

    def __call__(self, x: Any) -> Any:
        """(count, n) to (len(self), n), in the floating type of x."""
        out = np.empty((len(self), x.shape[1]), x.dtype)
        out[0] = 1
        for rows, parents, variable in self._calls:
            np.multiply(out[parents], x[variable], out=out[rows])
        return out
