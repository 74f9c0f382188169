"""Random draws of environments on road networks, as numpy's `Generator` makes them: normal numbers, and two of several.

The ziggurat of Marsaglia and Tsang (2000) as in numpy, with the tables that numba contains.
"""

from __future__ import annotations

import math

from numba.np.random._constants import (
    fi_double,
    ki_double,
    wi_double,
    ziggurat_nor_inv_r,
    ziggurat_nor_r,
)

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.random import GeneratorRow, below, next_64, uniform

__all__ = ["normal", "two_of"]

_EDGES, _WIDTHS, _HEIGHTS = ki_double, wi_double, fi_double
_FAR, _OVER_FAR = float(ziggurat_nor_r), float(ziggurat_nor_inv_r)


@kernel_inline
def _share(row: GeneratorRow) -> float:
    """A number from 0 to 1."""
    return uniform(row, 0.0, 1.0)


@kernel_no_refcount
def normal(row: GeneratorRow) -> float:
    """`Generator.normal()`."""
    while True:
        word = next_64(row)
        layer = int(word & 0xFF)
        size = (word >> 9) & 0x000FFFFFFFFFFFFF
        x = size * _WIDTHS[layer]
        if (word >> 8) & 1:
            x = -x
        if size < _EDGES[layer]:
            return x
        if layer == 0:
            while True:
                beyond = -_OVER_FAR * math.log1p(-_share(row))
                height = -math.log1p(-_share(row))
                if height + height > beyond * beyond:
                    return -(_FAR + beyond) if (size >> 8) & 1 else _FAR + beyond
        if (_HEIGHTS[layer - 1] - _HEIGHTS[layer]) * _share(row) + _HEIGHTS[layer] < math.exp(-0.5 * x * x):
            return x


@kernel_inline
def two_of(row: GeneratorRow, n: int) -> tuple[int, int]:
    """`Generator.choice(n, size=2, replace=False)`: Floyd's algorithm, and a shuffle."""
    one = below(row, n - 1)
    two = below(row, n)
    if two == one:
        two = n - 1
    if below(row, 2) == 0:
        one, two = two, one
    return one, two
