"""Sums of products as numpy computes them on this machine, and the small functions of highway-env's `utils`.

`np.dot` of short vectors ends in a BLAS kernel, which on most processors fuses multiplication and addition. The result
differs in the last place from that of two operations. A test at the first use finds out how this machine computes.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.state import FloatArray

__all__ = ["Sums", "clip", "dot2", "dot3", "fma", "not_zero", "sums_of_numpy", "wrap_to_pi"]

_built_in: Any = intrinsic
"""numba's `intrinsic` as `Any`: its type stubs do not describe the decorator."""


class Sums:
    """How a sum of products is computed: as separate operations, or fused from left to right."""

    SEPARATE, FUSED, OTHER = range(3)


@_built_in
def fma(typingctx: Any, a: Any, b: Any, c: Any) -> Any:
    """a b + c, rounded once."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        double = ir.DoubleType()
        kind = ir.FunctionType(double, [double, double, double])
        function = builder.module.declare_intrinsic("llvm.fma", [double], kind)
        return builder.call(function, args)

    return types.float64(types.float64, types.float64, types.float64), codegen


@kernel_inline
def dot2(sums: int, a0: float, b0: float, a1: float, b1: float) -> float:
    """`np.dot` of two vectors of two numbers."""
    return fma(a1, b1, a0 * b0) if sums == 1 else a0 * b0 + a1 * b1


@kernel_inline
def dot3(sums: int, a0: float, b0: float, a1: float, b1: float, a2: float, b2: float) -> float:
    """`np.dot` of two vectors of three numbers."""
    return fma(a2, b2, fma(a1, b1, a0 * b0)) if sums == 1 else a0 * b0 + a1 * b1 + a2 * b2


@kernel_inline
def not_zero(x: float) -> float:
    """highway-env's `not_zero`: the number, or 0.01 with its sign if it is nearer to zero."""
    if abs(x) > 1e-2:
        return x
    return 1e-2 if x >= 0 else -1e-2


@kernel_inline
def wrap_to_pi(x: float) -> float:
    """An angle in [-pi, pi)."""
    turned = x + math.pi
    if not 0.0 <= turned < 2 * math.pi:
        turned %= 2 * math.pi
    return turned - math.pi


@kernel_inline
def clip(x: float, low: float, high: float) -> float:
    """`np.clip` of a number."""
    return min(max(x, low), high)


@kernel_no_refcount
def _dots(sums: int, a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """`np.dot` of each pair of rows of two or three numbers, written to `out`."""
    for i in range(len(a)):
        if a.shape[1] == 2:
            out[i] = dot2(sums, a[i, 0], b[i, 0], a[i, 1], b[i, 1])
        else:
            out[i] = dot3(sums, a[i, 0], b[i, 0], a[i, 1], b[i, 1], a[i, 2], b[i, 2])


@lru_cache(maxsize=1)
def sums_of_numpy() -> tuple[int, int]:
    """How numpy computes `np.dot` of two and three numbers, and the product of a 2 x 2 and a 2 x 4 matrix (`Sums`)."""
    rng = np.random.default_rng(0)
    kinds: set[int] = set()
    for size in (2, 3):
        a, b = rng.normal(size=(2, 500, size))
        kinds.add(_how(a, b, np.array([np.dot(x, y) for x, y in zip(a, b, strict=True)])))
    dots = kinds.pop() if len(kinds) == 1 else Sums.OTHER
    left, right = rng.normal(size=(100, 2, 2)), rng.normal(size=(100, 4, 2))
    made = np.array([x @ y.T for x, y in zip(left, right, strict=True)])
    rows = np.repeat(left[:, :, None], 4, axis=2).reshape(-1, 2)
    columns = np.repeat(right[:, None], 2, axis=1).reshape(-1, 2)
    return dots, _how(rows, columns, made.reshape(-1))


def _how(a: FloatArray, b: FloatArray, made: FloatArray) -> int:
    """The kind of sums (`Sums`) by which the products of the rows of a and b were `made`."""
    out = np.empty(len(a))
    for sums in (Sums.SEPARATE, Sums.FUSED):
        _dots(sums, np.ascontiguousarray(a), np.ascontiguousarray(b), out)
        if np.array_equal(out, made):
            return sums
    return Sums.OTHER
