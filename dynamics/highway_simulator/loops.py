"""numpy's own loops, called from compiled code by their address.

On processors with AVX-512 numpy computes tangents, arcs and powers with vector code that may differ from the C
library's in the last place. highway-env calls numpy. An exact copy has to call the same code: the inner loops that
numpy's ufuncs hold (`PyUFuncObject.functions`). Their addresses differ from process to process. The kernels take them
as numbers, so that the cached machine code remains valid in the next process.
"""

from __future__ import annotations

import ctypes
import ctypes.util
from functools import lru_cache
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from dynamics.errors import PlatformError

__all__ = ["LOOPS", "Loop", "addresses", "apply", "apply_two", "at", "at_two", "c_pow"]

_built_in: Any = intrinsic
"""numba's `intrinsic` as `Any`: its type stubs do not describe the decorator."""

_HEAD = 2 * ctypes.sizeof(ctypes.c_void_p)
_FUNCTIONS, _DATA = _HEAD + 16, _HEAD + 24
_NTYPES, _TYPES = _HEAD + 32, _HEAD + 48
"""Offsets in `PyUFuncObject`: after the head nin, nout, nargs, identity; after the tables ntypes, then name, types."""
_DOUBLE = np.dtype(np.float64).num


class Loop:
    """Index of a loop in the table of `addresses`."""

    TAN, ARCTAN, ARCSIN, COS, SIN, POWER, C_POW, ARCTAN2 = range(8)


LOOPS: tuple[np.ufunc, ...] = (np.tan, np.arctan, np.arcsin, np.cos, np.sin, np.power)
"""The ufuncs in the order of `Loop`, before the C library's pow, which Python's `**` of two floats calls."""


@lru_cache(maxsize=1)
def addresses() -> np.ndarray[Any, Any]:
    """The addresses of numpy's loops over 64-bit floats and of their data, (loops, 2) int64, in the order of `Loop`.

    All calls return the same array, because finding a library starts a process. Do not write to it.

    Raises
    ------
    PlatformError
        If this numpy stores them elsewhere, or no C library is found.
    """
    return np.array([*map(_loop, LOOPS), (_c_pow(), 0), _loop(np.arctan2)], dtype=np.int64)


def _c_pow() -> int:
    """The address of the C library's pow."""
    try:
        library = ctypes.CDLL(ctypes.util.find_library("m") or ctypes.util.find_library("c"))
        return ctypes.cast(library.pow, ctypes.c_void_p).value or 0
    except (OSError, AttributeError, TypeError) as error:
        raise PlatformError(f"the C library's pow cannot be found: {error}") from None


def _loop(ufunc: np.ufunc) -> tuple[int, int]:
    """The addresses of a ufunc's loop over 64-bit floats, and of its data."""
    base = id(ufunc)
    nin, nout = (ctypes.c_int.from_address(base + _HEAD + 4 * i).value for i in range(2))
    count = ctypes.c_int.from_address(base + _NTYPES).value
    if (nin, nout, count) != (ufunc.nin, ufunc.nout, ufunc.ntypes):
        raise PlatformError(f"numpy {np.__version__} keeps the loops of np.{ufunc.__name__} in another way")
    kinds = ctypes.string_at(ctypes.c_void_p.from_address(base + _TYPES).value or 0, count * ufunc.nargs)
    for i in range(count):
        if set(kinds[i * ufunc.nargs : (i + 1) * ufunc.nargs]) == {_DOUBLE}:
            functions = ctypes.c_void_p.from_address(base + _FUNCTIONS).value or 0
            data = ctypes.c_void_p.from_address(base + _DATA).value or 0
            size = ctypes.sizeof(ctypes.c_void_p)
            function = ctypes.c_void_p.from_address(functions + i * size).value or 0
            return function, ctypes.c_void_p.from_address(data + i * size).value or 0
    raise PlatformError(f"np.{ufunc.__name__} has no loop over 64-bit floats")


def _call(context: Any, builder: Any, loop: Any, data: Any, pointers: list[Any], n: Any, steps: list[int]) -> None:
    """Emit a call `loop(char **args, npy_intp const *dimensions, npy_intp const *steps, void *data)`."""
    byte, word = ir.IntType(8).as_pointer(), ir.IntType(64)
    kind = ir.FunctionType(ir.VoidType(), [byte.as_pointer(), word.as_pointer(), word.as_pointer(), byte])
    args = cgutils.alloca_once(builder, byte, size=len(pointers))
    strides = cgutils.alloca_once(builder, word, size=len(pointers))
    for i, (pointer, step) in enumerate(zip(pointers, steps, strict=True)):
        index = [ir.Constant(ir.IntType(32), i)]
        builder.store(builder.bitcast(pointer, byte), builder.gep(args, index))
        builder.store(ir.Constant(word, step), builder.gep(strides, index))
    dimensions = cgutils.alloca_once_value(builder, n)
    function = builder.inttoptr(loop, kind.as_pointer())
    builder.call(function, [args, dimensions, strides, builder.inttoptr(data, byte)])


@_built_in
def at(typingctx: Any, loop: Any, data: Any, x: Any) -> Any:
    """`ufunc(x)` of one number; `loop` and `data` are a row of `addresses`."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        loop, data, x = args
        source = cgutils.alloca_once_value(builder, x)
        target = cgutils.alloca_once(builder, x.type)
        _call(context, builder, loop, data, [source, target], ir.Constant(ir.IntType(64), 1), [8, 8])
        return builder.load(target)

    return types.float64(types.int64, types.int64, types.float64), codegen


@_built_in
def at_two(typingctx: Any, loop: Any, data: Any, x: Any, y: Any) -> Any:
    """`ufunc(x, y)` of two numbers; `loop` and `data` are a row of `addresses`."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        loop, data, x, y = args
        one, two = cgutils.alloca_once_value(builder, x), cgutils.alloca_once_value(builder, y)
        target = cgutils.alloca_once(builder, x.type)
        _call(context, builder, loop, data, [one, two, target], ir.Constant(ir.IntType(64), 1), [8, 8, 8])
        return builder.load(target)

    return types.float64(types.int64, types.int64, types.float64, types.float64), codegen


@_built_in
def c_pow(typingctx: Any, address: Any, x: Any, y: Any) -> Any:
    """The C library's `pow(x, y)`, which LLVM may not replace by a product."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        double = ir.DoubleType()
        function = builder.inttoptr(args[0], ir.FunctionType(double, [double, double]).as_pointer())
        return builder.call(function, args[1:])

    return types.float64(types.int64, types.float64, types.float64), codegen


def _pointer(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """The pointer to the data of an array."""
    return context.make_array(kind)(context, builder, value).data


@_built_in
def apply(typingctx: Any, loop: Any, data: Any, x: Any, out: Any, n: Any) -> Any:
    """`ufunc(x[:n], out=out[:n])` of contiguous arrays; `loop` and `data` are a row of `addresses`."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        loop, data, x, out, n = args
        pointers = [_pointer(context, builder, signature.args[i], value) for i, value in ((2, x), (3, out))]
        _call(context, builder, loop, data, pointers, n, [8, 8])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, x, out, types.int64), codegen


@_built_in
def apply_two(typingctx: Any, loop: Any, data: Any, x: Any, y: Any, out: Any, n: Any) -> Any:
    """`ufunc(x[:n], y[:n], out=out[:n])` of contiguous arrays; `loop` and `data` are a row of `addresses`."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        loop, data, x, y, out, n = args
        given = ((2, x), (3, y), (4, out))
        pointers = [_pointer(context, builder, signature.args[i], value) for i, value in given]
        _call(context, builder, loop, data, pointers, n, [8, 8, 8])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, x, y, out, types.int64), codegen
